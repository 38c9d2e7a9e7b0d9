"""A USD stage: a textured plane with UsdPreviewSurface in its specular workflow; also as .usdz.

`useSpecularWorkflow = 1` keeps F0 as it is. UsdPreviewSurface darkens the diffuse part by what is
reflected; the base colour is compensated (see specular_workflow.py). The stage is text (.usda); the
package is a zip without compression, every file at a multiple of 64 bytes, as USD asks. Stage units
are plane units, `metersPerUnit` says how long one is where that is known.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile

import numpy as np

from matcap.errors import UsageError
from matcap.export.specular_workflow import base_colour
from matcap.export.surface import TargetSurface
from matcap.export.texture_file import Stored
from matcap.export.textures import (
    BASE,
    CODED_HEIGHT,
    NORMAL,
    ROUGHNESS,
    SPECULAR,
    Export,
    ExportJob,
    coded_normal,
    scaled_height,
    seen,
    seen_normal,
)
from matcap.files.maker import MAKER

_ALIGNMENT = 64
_HEADER = 30  # bytes of a zip's local header, without name and extra field
# Any time: the same maps give the same bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


def usd(job: ExportJob) -> Export:
    """NAME.usda beside its textures, and NAME.usdz with all of them inside.

    Raises:
        UsageError: textures of floats were asked for.
    """
    if job.depth in ("half", "float"):
        raise UsageError("a .usdz holds PNGs only", where="--bits", remedy="give 8 or 16")
    colour, fine = job.depth_or("8"), job.depth_or("16")
    base, notes = base_colour(job)
    grey = np.repeat(job.picture("specular")[..., None], 3, axis=2)
    height, scale, midlevel = scaled_height(job, fine)
    textures = {
        "base_color": Stored(base, colour, srgb=True, meaning=BASE),
        "specular": Stored(grey, fine, meaning=SPECULAR),
        "roughness": Stored(job.picture("roughness"), fine, meaning=ROUGHNESS),
        "normal_gl": Stored(coded_normal(job), fine, meaning=f"{NORMAL}, +Y up (OpenGL)"),
        "height": Stored(height.values, height.depth, meaning=CODED_HEIGHT),
    }
    f0 = seen(textures["specular"])[:1]
    surface = TargetSurface(
        seen(textures["base_color"]),
        f0,
        seen(textures["roughness"]),
        seen_normal(textures["normal_gl"]),
        layer=f0,
    )
    files = {kind: f"{job.name}_{kind}.png" for kind in textures}
    stage = _stage(job, files, scale, midlevel).encode()
    package = _package(
        {f"{job.name}.usda": stage} | {file: textures[kind].png() for kind, file in files.items()}
    )
    facts = {"height": {"scale": scale * job.unit_length, "midlevel": midlevel, "unit": job.unit}}
    return Export(
        {file: textures[kind] for kind, file in files.items()},
        {f"{job.name}.usda": stage, f"{job.name}.usdz": package},
        surface,
        notes,
        facts,
    )


def _stage(job: ExportJob, files: dict[str, str], scale: float, midlevel: float) -> str:
    """The .usda text."""
    x, y = (side / 2.0 for side in job.extent)
    metres = 1.0 if job.millimetres is None else job.millimetres / 1000.0
    name = _identifier(job.name)
    textures = (
        _texture("BaseColor", files["base_color"], "float3 outputs:rgb", "sRGB"),
        _texture("Specular", files["specular"], "float3 outputs:rgb"),
        _texture("Roughness", files["roughness"], "float outputs:r"),
        _texture("Normal", files["normal_gl"], "float3 outputs:rgb", scale=2.0, bias=-1.0),
        _texture("Height", files["height"], "float outputs:r", scale=scale, bias=-scale * midlevel),
    )
    shaders = "\n".join(text.replace("@ROOT@", f"/{name}/Material") for text in textures)
    return f'''#usda 1.0
(
    customLayerData = {{
        string creator = "{MAKER}"
    }}
    defaultPrim = "{name}"
    metersPerUnit = {metres!r}
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

    def Material "Material"
    {{
        token outputs:displacement.connect = </{name}/Material/Surface.outputs:displacement>
        token outputs:surface.connect = </{name}/Material/Surface.outputs:surface>

        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </{name}/Material/BaseColor.outputs:rgb>
            float inputs:displacement.connect = </{name}/Material/Height.outputs:r>
            normal3f inputs:normal.connect = </{name}/Material/Normal.outputs:rgb>
            float inputs:roughness.connect = </{name}/Material/Roughness.outputs:r>
            color3f inputs:specularColor.connect = </{name}/Material/Specular.outputs:rgb>
            int inputs:useSpecularWorkflow = 1
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
    }}
}}
'''  # noqa: E501


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
    """The name as USD lets primitives be called."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"M_{plain}"


def _package(files: dict[str, bytes]) -> bytes:
    """A .usdz: the first file is the stage."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as package:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, _DATE)
            start = whole.tell() + _HEADER + len(name.encode())
            # An extra field, private to nobody, fills up to the next multiple of 64.
            fill = -(start + 4) % _ALIGNMENT
            info.extra = struct.pack("<HH", 0x1986, fill) + b"\0" * fill
            package.writestr(info, content)
    return whole.getvalue()
