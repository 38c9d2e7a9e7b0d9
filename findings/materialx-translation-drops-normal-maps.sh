#!/usr/bin/env bash
# MaterialX's translation of standard_surface to OpenPBR drops the normal map, and to others its strength.
#
# Behaviour: ShaderTranslator takes the texture before the normalmap node and leaves that node out.
# To open_pbr_surface nothing is connected to geometry_normal. To gltf_pbr the codes of the texture
# pass through unchanged (a dot node) to an input for a unit normal in the world: flat is (0.5, 0.5, 1)
# and leans by 35 degrees. To UsdPreviewSurface they are decoded (multiply), but the scale of the
# normalmap is gone. The documents are valid and nothing is logged.
# Why it matters: captured materials are often delivered as standard_surface and translated for
# what the receiver renders. Relief disappears, is tilted, or is twice as deep.
# Seen on 2026-12-01:
#   MaterialX 1.39.5
#   standard_surface: normalmap of scale 0.5
#   open_pbr_surface: no normal; gltf_pbr: image, dot; UsdPreviewSurface: image, multiply
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check MaterialX==1.39.5
venv/bin/python - <<'PY'
from importlib.metadata import version

import MaterialX as mx
from MaterialX.PyMaterialXGenShader import ShaderTranslator


def material():
    """A standard_surface with a normal map of strength 0.5."""
    document, library = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    document.setDataLibrary(library)
    graph = document.addNodeGraph("maps")
    graph.addNode("image", "texture", "vector3").setInputValue("file", "normal.png", "filename")
    decoded = graph.addNode("normalmap", "decoded", "vector3")
    decoded.addInput("in", "vector3").setNodeName("texture")
    decoded.setInputValue("scale", 0.5)
    graph.addOutput("relief", "vector3").setNodeName("decoded")
    surface = document.addNode("standard_surface", "surface", "surfaceshader")
    normal = surface.addInput("normal", "vector3")
    normal.setNodeGraphString("maps")
    normal.setOutputString("relief")
    document.addMaterialNode("leather", surface)
    return document


def translated(target, name):
    """What the normal of the translated material is: its source, and the last step in the translation."""
    document = material()
    ShaderTranslator.create().translateAllMaterials(document, target)
    surface = document.getNode("surface")
    assert document.validate()[0] and surface.getCategory() == target, "changed"
    put = surface.getInput(name)
    if put is None:
        return "no normal"
    step = put.getConnectedOutput().getConnectedNode()
    source = step.getInput("normal").getConnectedNode()
    last = step.getImplementation().getOutput(put.getOutputString()).getConnectedNode()
    return f"{source.getCategory()}, {last.getCategory()}"


source = material()
before = source.getNode("surface").getInput("normal").getConnectedOutput().getConnectedNode()
after = {target: translated(target, name) for target, name in
         (("open_pbr_surface", "geometry_normal"), ("gltf_pbr", "normal"), ("UsdPreviewSurface", "normal"))}
print("MaterialX", version("MaterialX"))
print(f"standard_surface: {before.getCategory()} of scale {before.getInputValue('scale')}")
print("; ".join(f"{target}: {found}" for target, found in after.items()))
assert list(after.values()) == ["no normal", "image, dot", "image, multiply"], "changed"
PY
