"""Run by Blender's Python: build an exported material and render it.

    python render_blender.py FILE COLUMNS ROWS EXTENT X Y Z PICTURE.exr [uncorrected]

FILE is an exported script (.py), run as it is, or a stage (.usda) or binary (.glb), imported.

With `uncorrected`, Cycles does not correct for bump maps in any material, as in the script.


One texel a pixel, under a point light at X, Y, Z, of 1000 W.
"""

import math
import runpy
import sys
from pathlib import Path

import bpy
import mathutils

words = sys.argv[1:]
uncorrected = words[-1] == "uncorrected"
file, columns, rows, extent, *place, out = words[:8]
bpy.ops.wm.read_factory_settings(use_empty=True)
if Path(file).suffix == ".py":
    runpy.run_path(file, run_name="__main__")
elif Path(file).suffix == ".glb":
    bpy.ops.import_scene.gltf(filepath=file)
else:
    bpy.ops.wm.usd_import(filepath=file)
for one in bpy.data.objects:
    if one.type == "MESH" and Path(file).suffix != ".py":
        # y is up in these files and importers turn them: back to facing +z.
        points = [vertex.co.copy() for vertex in one.data.vertices]
        flat = min(range(3), key=lambda axis: max(abs(p[axis]) for p in points))
        one.parent = None
        one.matrix_world = mathutils.Matrix.Identity(4)
        if flat == 1:
            one.matrix_world = mathutils.Matrix.Rotation(math.radians(-90.0), 4, "X")
for material in bpy.data.materials:
    for owner in (material, material.cycles):
        if uncorrected and hasattr(owner, "use_bump_map_correction"):
            owner.use_bump_map_correction = False
    for node in material.node_tree.nodes:
        if node.type == "TEX_IMAGE":
            node.interpolation = "Closest"
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("black")
if bpy.app.version < (5, 0, 0):
    scene.world.use_nodes = True
scene.world.node_tree.nodes.clear()
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.angle = math.radians(45.0)
camera.location = (0.0, 0.0, float(extent) / 2.0 / math.tan(math.radians(22.5)))
light = bpy.data.objects.new("light", bpy.data.lights.new("light", "POINT"))
light.data.energy = 1000.0
light.data.shadow_soft_size = 0.0
light.location = tuple(float(c) for c in place)
for one in (camera, light):
    scene.collection.objects.link(one)
scene.camera = camera
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.samples = 16
scene.cycles.max_bounces = 0
scene.cycles.use_denoising = False
scene.cycles.pixel_filter_type = "BOX"
scene.render.threads_mode = "FIXED"
scene.render.threads = 1
scene.render.resolution_x, scene.render.resolution_y = int(columns), int(rows)
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = out
bpy.ops.render.render(write_still=True)
