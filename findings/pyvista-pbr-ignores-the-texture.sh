#!/usr/bin/env bash
# PyVista draws a physically based mesh white, whatever texture it is given.
#
# Behaviour: add_mesh(mesh, texture=t) shows t. With pbr=True it takes t without a word and shades
# the mesh white; colour by `color=` is kept. VTK reads base colour from another place
# (Property.SetBaseColorTexture), which add_mesh does not fill.
# Why it matters: a captured albedo seems to come out white, or a roughness is judged on a white
# surface.
# Seen on 2026-11-30 (needs a display, EGL or OSMesa for VTK):
#   PyVista 0.49.1, VTK 9.7.2
#   red texture: [255, 0, 0]; with pbr=True [149, 149, 149], as a black texture does; colour red: [149, 19, 19]
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pyvista==0.49.1 vtk==9.7.2 numpy==2.4.6
venv/bin/python - 2> errors <<'PY' || { cat errors >&2; exit 1; }
import numpy as np, pyvista, vtk


def shown(pbr, **what):
    plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64), lighting="none")
    shading = {"pbr": True, "roughness": 1.0, "metallic": 0.0} if pbr else {}
    plotter.add_mesh(pyvista.Plane(i_resolution=1, j_resolution=1), **shading, **what)
    plotter.add_light(pyvista.Light(light_type="headlight"))
    plotter.view_xy()
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return picture[32, 32].tolist()


def texture(*rgb):
    return pyvista.numpy_to_texture(np.full((4, 4, 3), rgb, np.uint8))


plain, red, black = shown(False, texture=texture(255, 0, 0)), *(
    shown(True, texture=texture(*rgb)) for rgb in ((255, 0, 0), (0, 0, 0))
)
colour = shown(True, color="red")
print(f"PyVista {pyvista.__version__}, VTK {vtk.VTK_VERSION}")
print(f"red texture: {plain}; with pbr=True {red}, as a black texture does; colour red: {colour}")
assert plain[0] > 5 * plain[1] + 50 and colour[0] > 4 * colour[1], "changed"
assert red == black and len(set(red)) == 1, "changed: the texture is shown"
PY
