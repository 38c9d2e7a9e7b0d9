#!/usr/bin/env bash
# Mitsuba turns textures upside down on OBJ files alone: the same square as PLY shows them mirrored.
#
# Behaviour: flip_tex_coords is true by default for `obj`, false for `ply`, and `rectangle` has no
# such option. A texture whose first row is white shows white on top of an OBJ and at the bottom of
# a PLY with the same positions and texture coordinates, and of a rectangle. With
# flip_tex_coords=False all three agree.
# Why it matters: with a mirrored normal map light comes from below; albedo and height still look
# right, so that nothing is noticed on an irregular texture.
# Seen on 2026-11-30:
#   Mitsuba 3.9.1
#   first row is shown: rectangle bottom, ply bottom, obj top, obj with flip_tex_coords=False bottom
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mitsuba==3.9.1 numpy==2.4.6
venv/bin/python - <<'PY'
from pathlib import Path

import mitsuba, numpy as np

mitsuba.set_variant("scalar_rgb")
corners, turns = [(-1, -1), (1, -1), (1, 1), (-1, 1)], [(0, 0), (1, 0), (1, 1), (0, 1)]
Path("square.obj").write_text(
    "".join(f"v {x} {y} 0\n" for x, y in corners) + "".join(f"vt {u} {v}\n" for u, v in turns)
    + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
)
mesh = mitsuba.Mesh("square", 4, 2, has_vertex_texcoords=True)
values = mitsuba.traverse(mesh)
values["vertex_positions"] = np.float32([(x, y, 0) for x, y in corners]).ravel()
values["vertex_texcoords"] = np.float32(turns).ravel()
values["faces"] = np.uint32([0, 1, 2, 0, 2, 3])
values.update()
mesh.write_ply("square.ply")
texture = np.zeros((2, 1, 3), np.float32)
texture[0] = 1.0
mitsuba.Bitmap(texture).write("texture.exr")


def shown(shape):
    bitmap = {"type": "bitmap", "filename": "texture.exr", "filter_type": "nearest", "raw": True}
    diffuse = {"type": "twosided", "inside": {"type": "diffuse", "reflectance": bitmap}}
    above = mitsuba.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    scene = {"type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"},
             "shape": {**shape, "bsdf": diffuse},
             "camera": {"type": "orthographic", "to_world": above, "film": film}}
    picture = np.array(mitsuba.render(mitsuba.load_dict(scene), spp=16))
    return "top" if picture[1].mean() > picture[6].mean() else "bottom"


obj = {"type": "obj", "filename": "square.obj"}
found = [shown(shape) for shape in ({"type": "rectangle"}, {"type": "ply", "filename": "square.ply"},
                                    obj, {**obj, "flip_tex_coords": False})]
print("Mitsuba", mitsuba.__version__)
names = ("rectangle", "ply", "obj", "obj with flip_tex_coords=False")
print("first row is shown: " + ", ".join(f"{a} {b}" for a, b in zip(names, found)))
assert found == ["bottom", "bottom", "top", "bottom"], "changed"
PY
