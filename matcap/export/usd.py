"""A USD stage (.usda, .usdz): a textured plane with UsdPreviewSurface and MaterialX's OpenPBR.

- Specular workflow: `useSpecularWorkflow = 1`, which keeps any F0. Programs without it (Blender,
  three.js) use the specular colour as a tint of the reflection by `ior`, which is therefore set to
  reflect everything.
- Metallic workflow: one index of refraction for all dielectrics.

UsdPreviewSurface darkens the diffuse part under the specular layer; the base colour compensates
(workflows.py). Renderers with MaterialX use `mtlx:surface`, which has a smaller residual.

Displacement is a variant, off by default: programs that cannot displace use the height as a bump
map on top of the normal map (Blender: 5 to 8 % off at grazing light).

Lengths are metres. A .usdz is an uncompressed zip whose files start at multiples of 64 bytes.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

from matcap.export import textures as tex
from matcap.export.gltf import ior
from matcap.export.job import ExportJob, MapRows, Picture, rgb
from matcap.export.materialx import INPUTS, Layered
from matcap.export.presets import EngineModel, PackedMaterial
from matcap.export.shading import MadeSurface, Reader, TargetShading, TargetSurface
from matcap.export.texture_file import TextureFile
from matcap.export.workflows import Metallic, base_colour, clipping_notes, specular_colour
from matcap.files.names import MAKER

SHADING = TargetShading(layer="half", each=True)
# Shading of programs that convert UsdPreviewSurface to a Principled BSDF with a specular tint.
_FALLBACK = TargetShading(layer="half", each=True, compensated=True)
_MIRROR = 1000.0  # index of refraction with F0 = 0.996
_LARGEST_F0 = 0.9
_ALIGNMENT = 64
_HEADER = 30  # bytes of a zip's local header, without name and extra field
# A fixed time, so that the same maps give the same bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


def usd_specular(job: ExportJob) -> tex.Export:
    """NAME.usda with its textures, and NAME.usdz with all of them inside; specular workflow.

    Raises:
        UsageError: a depth or format that .usdz does not allow.
    """
    job.check_formats("a .usdz", ("png", "jpg"), floats=False)

    def tint(piece: MapRows) -> Picture:
        return rgb(specular_colour(piece, SHADING))

    of = partial(TextureFile.of, job)
    inputs = {
        "base_color": of(lambda p: base_colour(p, SHADING), "8", tex.BASE, srgb=True),
        # sRGB-encoded: three.js decodes it regardless of the stage's sourceColorSpace.
        "specular": of(tint, "16", tex.SPECULAR, srgb=True),
        **_shared(job),
    }
    in_browsers = {kind: one.in_browsers() for kind, one in inputs.items()}
    tinted = ((_MIRROR - 1.0) / (_MIRROR + 1.0)) ** 2
    surfaces: dict[str, MadeSurface] = {
        "specular": partial(_seen_specular, inputs),
        "without it": partial(_seen_specular, inputs, factor=tinted, shading=_FALLBACK),
        "in three.js": partial(
            _seen_specular, in_browsers, factor=tinted, shading=_FALLBACK, relief=2.0
        ),
    }
    return _export(job, inputs, _MIRROR, surfaces)


def _seen_specular(
    inputs: dict[str, TextureFile],
    read: Reader,
    factor: float = 1.0,
    shading: TargetShading = SHADING,
    relief: float = 1.0,
) -> TargetSurface:
    """The reflectance that renderers show of the specular workflow.

    Args:
        factor: on the specular colour; below 1 in programs that ignore `useSpecularWorkflow`.
        relief: factor on slopes, as three.js takes the scale of the normal texture.
    """
    f0 = read(inputs["specular"]) * factor
    normal = tex.signed(read(inputs["normal_gl"]))
    return TargetSurface(
        read(inputs["base_color"]),
        f0,
        read(inputs["roughness"]),
        normal * normal.new_tensor([relief, relief, 1.0])[:, None, None],
        layer=f0,
        shading=shading,
    )


def usd_metallic(job: ExportJob) -> tex.Export:
    """NAME.usda and NAME.usdz in the metallic workflow.

    Raises:
        UsageError: a depth or format that .usdz does not allow.
    """
    job.check_formats("a .usdz", ("png", "jpg"), floats=False)
    shared = _shared(job)
    start = EngineModel(SHADING, "metallic", even=_LARGEST_F0).of(job)
    model = start.nearest(
        job, lambda tried: partial(_seen, tried, _metallic_inputs(job, tried, shared))
    )
    inputs, index = _metallic_inputs(job, model, shared), ior(model.dielectric[0])
    made = _export(job, inputs, index, {"metallic": partial(_seen, model, inputs)})
    return replace(made, entries=made.entries | {"metallic": model.form})


def _metallic_inputs(
    job: ExportJob, model: EngineModel, shared: dict[str, TextureFile]
) -> dict[str, TextureFile]:
    def metallic(piece: MapRows) -> Metallic:
        return PackedMaterial(piece, model).metallic

    of = partial(TextureFile.of, job)
    return {
        "base_color": of(lambda piece: metallic(piece).base, "8", tex.BASE, srgb=True),
        "metallic": of(lambda piece: metallic(piece).metallic, "8", "metallic"),
        **shared,
    }


def _seen(model: EngineModel, inputs: dict[str, TextureFile], read: Reader) -> TargetSurface:
    """The reflectance that renderers show of the metallic workflow."""
    base, metal = read(inputs["base_color"]), read(inputs["metallic"])
    colour = 1.0 - metal + base * metal  # F90: metals keep their colour at grazing angles
    mixed = model.dielectric[0] * (1.0 - metal) * colour + colour * metal
    return TargetSurface(
        base * (1.0 - metal),
        mixed,
        read(inputs["roughness"]),
        tex.signed(read(inputs["normal_gl"])),
        f90=colour,
        layer=mixed,
        shading=SHADING,
    )


def _shared(job: ExportJob) -> dict[str, TextureFile]:
    """Textures of both workflows."""
    of = partial(TextureFile.of, job)
    return {
        "roughness": of(tex.picture("roughness"), "16", tex.ROUGHNESS),
        "normal_gl": of(tex.coded_normal, "16", f"{tex.NORMAL}, +Y up (OpenGL)"),
        "height": of(tex.coded_height, "16", tex.CODED_HEIGHT, lossy=False),
        "occlusion": of(tex.picture("occlusion"), "8", tex.OCCLUSION),
    }


def _export(
    job: ExportJob, inputs: dict[str, TextureFile], index: float, surfaces: dict[str, MadeSurface]
) -> tex.Export:
    """The export of textures of UsdPreviewSurface by kind, and its index of refraction."""
    layered = Layered.of(job)
    label = "mtlx_specular" if layered.kind == "tint" else "mtlx_metalness"
    textures = inputs | {"mtlx_base": layered.base, label: layered.second}
    files = tex.file_names(job.name, textures)
    stage = _stage(job, index, layered, files).encode()

    def openpbr(read: Reader) -> TargetSurface:
        return layered.surface(tex.standard_textures(job), read)

    def package(folder: Path) -> bytes:
        # Read one by one, to bound memory.
        contents = ((file, (folder / file).read_bytes()) for file in files.values())
        return _package(chain([(f"{job.name}.usda", stage)], contents))

    documents: dict[str, bytes | Callable[[Path], bytes]] = {
        f"{job.name}.usda": stage, f"{job.name}.usdz": package,
    }  # fmt: skip
    return tex.Export(
        tex.by_file(job.name, textures),
        documents,
        surfaces | {"mtlx": openpbr},
        (*clipping_notes(job, SHADING), *job.size_notes()),
        tex.height_entry(job, *job.height_code) | tex.occlusion_entry(job),
    )


def _stage(job: ExportJob, index: float, layered: Layered, files: dict[str, str]) -> str:
    """The text of the .usda file."""
    x, y = (side * job.metres / 2.0 for side in job.extent)
    name = _identifier(job.name)
    scale, midlevel = job.height_code
    scale *= job.metres
    textures = [
        _texture("BaseColor", files["base_color"], "float3 outputs:rgb", "sRGB"),
        _texture("Roughness", files["roughness"], "float outputs:r"),
        _texture("Normal", files["normal_gl"], "float3 outputs:rgb", scale=2.0, bias=-1.0),
        _texture("Height", files["height"], "float outputs:r", scale=scale, bias=-scale * midlevel),
        _texture("Occlusion", files["occlusion"], "float outputs:r"),
    ]
    if "specular" in files:
        textures.append(_texture("Specular", files["specular"], "float3 outputs:rgb", "sRGB"))
        link = f"</{name}/Material/Specular.outputs:rgb>"
        workflow = f"""color3f inputs:specularColor.connect = {link}
            int inputs:useSpecularWorkflow = 1
            float inputs:metallic = 0"""
    else:
        textures.append(_texture("Metallic", files["metallic"], "float outputs:r"))
        workflow = f"""float inputs:metallic.connect = </{name}/Material/Metallic.outputs:r>
            int inputs:useSpecularWorkflow = 0"""
    textures.append(_network(job, layered, files))
    shaders = "\n".join(text.replace("@ROOT@", f"/{name}/Material") for text in textures)
    return f'''#usda 1.0
(
    customLayerData = {{
        string creator = "{MAKER}"
    }}
    defaultPrim = "{name}"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "{name}" (
    kind = "component"
)
{{
    def Mesh "Plane" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        float3[] extent = [({-x!r}, {-y!r}, 0), ({x!r}, {y!r}, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        rel material:binding = </{name}/Material>
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)] (
            interpolation = "vertex"
        )
        point3f[] points = [({-x!r}, {-y!r}, 0), ({x!r}, {-y!r}, 0), ({x!r}, {y!r}, 0), ({-x!r}, {y!r}, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
    }}

    def Material "Material" (
        variants = {{
            string displacement = "off"
        }}
        prepend variantSets = "displacement"
    )
    {{
        token outputs:mtlx:surface.connect = </{name}/Material/OpenPBR.outputs:out>
        token outputs:surface.connect = </{name}/Material/Surface.outputs:surface>

        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </{name}/Material/BaseColor.outputs:rgb>
            float inputs:ior = {index!r}
            normal3f inputs:normal.connect = </{name}/Material/Normal.outputs:rgb>
            float inputs:roughness.connect = </{name}/Material/Roughness.outputs:r>
            float inputs:occlusion.connect = </{name}/Material/Occlusion.outputs:r>
            {workflow}
            token outputs:displacement
            token outputs:surface
        }}

        def Shader "Coordinates"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}

{shaders}
        variantSet "displacement" = {{
            "off" {{
            }}
            "on" {{
                token outputs:displacement.connect = </{name}/Material/Surface.outputs:displacement>

                over "Surface"
                {{
                    float inputs:displacement.connect = </{name}/Material/Height.outputs:r>
                }}
            }}
        }}
    }}
}}
'''  # noqa: E501


def _network(job: ExportJob, layered: Layered, files: dict[str, str]) -> str:
    """The OpenPBR network in USD (UsdMtlx)."""
    taken = INPUTS["open_pbr_surface"]
    kinds = {"color3": "color3f", "float": "float", "vector3": "float3"}
    is_tint = layered.kind == "tint"
    grey = is_tint and not job.coloured
    second = ("color3", "srgb_texture") if is_tint and job.coloured else ("float", "raw")
    sources = {
        "base_color": ("MtlxBase", files["mtlx_base"], "color3", "srgb_texture"),
        layered.kind: (
            "MtlxSpecular" if is_tint else "MtlxMetalness",
            files["mtlx_specular" if is_tint else "mtlx_metalness"],
            *second,
        ),
        "roughness": ("MtlxRoughness", files["roughness"], "float", "raw"),
        "normal": ("MtlxNormalTexture", files["normal_gl"], "vector3", "raw"),
    }
    made = {"normal": "MtlxNormal"} | ({"tint": "MtlxTint"} if grey else {})
    links = [
        f"            {kinds[kind]} inputs:{input_}.connect = "
        f"<@ROOT@/{made.get(name, sources[name][0])}.outputs:out>\n"
        for name, (input_, kind) in taken.items()
        if name in sources
    ]
    text = f"""        def Shader "OpenPBR"
        {{
            uniform token info:id = "ND_open_pbr_surface_surfaceshader"
{"".join(links)}            float inputs:{taken["ior"][0]} = {layered.ior!r}
            token outputs:out
        }}

        def Shader "MtlxNormal"
        {{
            uniform token info:id = "ND_normalmap_float"
            float3 inputs:in.connect = <@ROOT@/MtlxNormalTexture.outputs:out>
            float3 outputs:out
        }}

{_GREY_TINT if grey else ""}        def Shader "MtlxCoordinates"
        {{
            uniform token info:id = "ND_geompropvalue_vector2"
            string inputs:geomprop = "st"
            float2 outputs:out
        }}
"""
    for name, file, kind, space in sources.values():
        text += f'''
        def Shader "{name}"
        {{
            uniform token info:id = "ND_image_{kind}"
            asset inputs:file = @./{file}@ (
                colorSpace = "{space}"
            )
            float2 inputs:texcoord.connect = <@ROOT@/MtlxCoordinates.outputs:out>
            {kinds[kind]} outputs:out
        }}
'''
    return text


_GREY_TINT = """        def Shader "MtlxTint"
        {
            uniform token info:id = "ND_convert_float_color3"
            float inputs:in.connect = <@ROOT@/MtlxSpecular.outputs:out>
            color3f outputs:out
        }

"""


def _texture(
    name: str, file: str, output: str, space: str = "raw", scale: float = 1.0, bias: float = 0.0
) -> str:
    factors = ""
    if (scale, bias) != (1.0, 0.0):
        factors = (
            f"            float4 inputs:bias = ({bias!r}, {bias!r}, {bias!r}, 0)\n"
            f"            float4 inputs:scale = ({scale!r}, {scale!r}, {scale!r}, 1)\n"
        )
    return f'''        def Shader "{name}"
        {{
            uniform token info:id = "UsdUVTexture"
{factors}            asset inputs:file = @./{file}@
            token inputs:sourceColorSpace = "{space}"
            float2 inputs:st.connect = <@ROOT@/Coordinates.outputs:result>
            token inputs:wrapS = "repeat"
            token inputs:wrapT = "repeat"
            {output}
        }}
'''


def _identifier(name: str) -> str:
    """The name as a valid USD identifier."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"M_{plain}"


def _package(files: Iterable[tuple[str, bytes]]) -> bytes:
    """The .usdz of (name, content) pairs, the stage first."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as package:
        for name, content in files:
            info = zipfile.ZipInfo(name, _DATE)
            start = whole.tell() + _HEADER + len(name.encode())
            # Pad with an extra field to the next multiple of 64.
            fill = -(start + 4) % _ALIGNMENT
            info.extra = struct.pack("<HH", 0x1986, fill) + b"\0" * fill
            package.writestr(info, content)
    return whole.getvalue()
