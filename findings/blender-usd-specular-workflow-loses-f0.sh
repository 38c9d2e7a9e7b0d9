#!/usr/bin/env bash
# Blender's USD importer takes the F0 of the specular workflow for a tint of 4 %: F0 of 0.2 becomes 0.008.
#
# Behaviour: with useSpecularWorkflow = 1, UsdPreviewSurface's specularColor is the reflectance at normal
# incidence and ior is not used for it. Blender connects specularColor to "Specular Tint", which
# multiplies the F0 of ior. Metals, black with a coloured specularColor, stay nearly black. Its exporter
# writes the same material without the workflow: whoever reads it next has 0.04. No warning is given.
# Why it matters: it is the workflow in which USD holds diffuse albedo and F0 maps of captured
# materials as they are. The metallic workflow gets there through Blender.
# Seen on 2026-12-01:
#   Blender 5.0.1
#   a mirror under a white sky, F0 0.04 0.20 1.00: 0.0016 0.0080 0.0400; metallic 1, colour 0.20: 0.2000
#   exported again: useSpecularWorkflow absent, specularColor absent
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bpy==5.0.1 numpy==1.26.4
venv/bin/python -W ignore - > log <<'PY'
from pathlib import Path

import bpy, numpy as np

SHEET = """#usda 1.0
( defaultPrim = "World"
  metersPerUnit = 1
  upAxis = "Z" )
def Xform "World" {
  def Mesh "Sheet" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    rel material:binding = </World/Paint>
  }
  def Material "Paint" {
    token outputs:surface.connect = </World/Paint/Surface.outputs:surface>
    def Shader "Surface" {
      uniform token info:id = "UsdPreviewSurface"
      float inputs:roughness = 0
      float inputs:ior = 1.5
      INPUTS
      token outputs:surface
    }
  }
}
"""


def seen(inputs):
    """Radiance of the sheet from above under a sky of 1, by Cycles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    Path("sheet.usda").write_text(SHEET.replace("INPUTS", "\n      ".join(inputs)))
    bpy.ops.wm.usd_import(filepath=str(Path("sheet.usda").resolve()), import_cameras=False, import_lights=False)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    eye = bpy.data.cameras.new("eye")
    eye.type, eye.ortho_scale = "ORTHO", 0.5
    scene.camera = bpy.data.objects.new("eye", eye)
    scene.camera.location = (0, 0, 2)
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 64
    scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(Path("seen.exr").resolve())
    bpy.ops.render.render(write_still=True)
    return float(np.mean(np.array(bpy.data.images.load(scene.render.filepath).pixels[:]).reshape(-1, 4)[:, :3]))


def specular(f0):
    black = "color3f inputs:diffuseColor = (0, 0, 0)"
    return seen([black, "int inputs:useSpecularWorkflow = 1", f"color3f inputs:specularColor = ({f0}, {f0}, {f0})"])


found = [specular(f0) for f0 in (0.04, 0.2, 1.0)]
bpy.ops.wm.usd_export(filepath=str(Path("again.usda").resolve()))
again = Path("again.usda").read_text()
state = {name: "present" if name in again else "absent" for name in ("useSpecularWorkflow", "specularColor")}
metal = seen(["float inputs:metallic = 1", "color3f inputs:diffuseColor = (0.2, 0.2, 0.2)"])
print("SEEN Blender", bpy.app.version_string)
print(f"SEEN a mirror under a white sky, F0 0.04 0.20 1.00: {' '.join(f'{v:.4f}' for v in found)}; metallic 1, colour 0.20: {metal:.4f}")
print("SEEN exported again: " + ", ".join(f"{name} {what}" for name, what in state.items()))
assert np.allclose(found, [0.0016, 0.008, 0.04], rtol=0.03) and abs(metal - 0.2) < 0.005, "changed"
assert set(state.values()) == {"absent"}, "changed"
PY
sed -n 's/^SEEN //p' log
