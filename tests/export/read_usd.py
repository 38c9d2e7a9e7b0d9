"""USD stages and packages through usd-core: validity and what the material reads."""

import cv2
import numpy as np
from exported import channels, linear
from pxr import Ar, Usd, UsdShade, UsdValidation

from matcap.export.shading import TargetShading, TargetSurface


def complaints(path) -> list[str]:
    """Everything that the validators of usd-core find wrong.

    It comes without MaterialX's nodes, and does not know their names: misnamed() does.
    """
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    context = UsdValidation.ValidationContext(validators)
    said = [error.GetMessage() for error in context.Validate(Usd.Stage.Open(str(path)))]
    return [one for one in said if "'ND_" not in one]


def misnamed(path) -> list[str]:
    """Nodes and inputs of the output mtlx:surface, of other types than MaterialX's library has."""
    import MaterialX as mx

    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    types = {"color3f": "color3", "float3": "vector3", "float2": "vector2", "asset": "filename"}
    found = []
    stage = Usd.Stage.Open(str(path))
    reached = list(network(stage))
    assert len(reached) in (7, 8)  # a grey F0 is made a colour of
    for node in reached:
        definition = library.getNodeDef(node.GetIdAttr().Get())
        if definition is None:
            found.append(node.GetIdAttr().Get())
            continue
        for one in (*node.GetInputs(), *node.GetOutputs()):
            kind = str(one.GetTypeName())
            there = definition.getActiveInput(one.GetBaseName())
            if one in node.GetOutputs():
                there = definition.getActiveOutput(one.GetBaseName())
            if there is None or there.getType() not in (types.get(kind, kind), "surfaceshader"):
                found.append(f"{node.GetPath()}.{one.GetBaseName()}")
    return found


def network(stage):
    """Every shader that is reached from the output mtlx:surface."""
    mesh = stage.GetDefaultPrim().GetChild("Plane")
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    start = material.GetSurfaceOutput("mtlx").GetConnectedSources()[0][0].source.GetPrim()
    waiting, seen = [start], {}
    while waiting:
        prim = waiting.pop()
        node = seen[prim.GetPath()] = UsdShade.Shader(prim)
        for one in node.GetInputs():
            for source in one.GetConnectedSources()[0]:
                if source.source.GetPath() not in seen:
                    waiting.append(source.source.GetPrim())
    return seen.values()


def shader(stage) -> UsdShade.Shader:
    """The surface shader bound to the stage's plane."""
    mesh = stage.GetDefaultPrim().GetChild("Plane")
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    return material.ComputeSurfaceSource()[0]


def read(shader_, input_):
    """(C, H, W) of what a UsdUVTexture gives to an input."""
    source = shader_.GetInput(input_).GetConnectedSources()[0][0]
    texture = UsdShade.Shader(source.source.GetPrim())
    assert source.sourceName in ("r", "rgb")
    place = Ar.ResolvedPath(texture.GetInput("file").Get().resolvedPath)
    raw = np.frombuffer(bytes(Ar.GetResolver().OpenAsset(place).GetBuffer()), dtype=np.uint8)
    stored = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
    coded = stored / np.float64(np.iinfo(stored.dtype).max)
    coded = coded[..., ::-1] if coded.ndim == 3 else coded
    if texture.GetInput("sourceColorSpace").Get() == "sRGB":
        coded = linear(coded)
    if texture.GetInput("scale"):
        coded = coded * texture.GetInput("scale").Get()[0] + texture.GetInput("bias").Get()[0]
    return channels(coded)


def surface(path) -> TargetSurface:
    """As UsdPreviewSurface has it with its specular workflow."""
    stage = Usd.Stage.Open(str(path))
    bound = shader(stage)
    assert bound.GetIdAttr().Get() == "UsdPreviewSurface"
    assert bound.GetInput("useSpecularWorkflow").Get() == 1
    f0 = read(bound, "specularColor")
    shading = TargetShading(layer="half", each=True)
    base, rough, normal = (read(bound, i) for i in ("diffuseColor", "roughness", "normal"))
    return TargetSurface(base, f0, rough, normal, layer=f0, shading=shading)
