"""Mitsuba 3 scenes and Blender scripts of a map set."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import partial
from importlib.resources import files as resources

import numpy as np

from matcap.export import textures as tex
from matcap.export.job import ExportJob, MapRows, Picture, brightest_channel
from matcap.export.shading import Reader, TargetShading, TargetSurface
from matcap.export.texture_file import TextureFile
from matcap.relight.scene import NAMED_LIGHTS, exposing_intensity

# Mitsuba 3 scenes: the maps under `matcap relight`'s light "top".
#
# NAME_exact.xml has matcap's reflectance, a BSDF in Python (scripts/matcap_bsdf.py). NAME.xml uses
# Mitsuba's plugins: a blend of `diffuse` and a metallic `principled`, whose Fresnel is Schlick's.
# Per texel a share w is specular with F0 / w, the rest diffuse; w is as large as the diffuse albedo
# allows. Diffuse albedo and F0 are exact; reflection at grazing is w instead of 1, and masking is
# separable Smith. Bare metal uses `principled` alone. (`roughconductor` has the metal's own
# Fresnel, 2 to 9 % of the light off Schlick's.)

_SCRIPT = "matcap_bsdf.py"
_LARGEST_SHARE = 0.98
_NO_DIFFUSE = 1e-3  # largest diffuse albedo of bare metal
_LARGEST_FILM = 512
_VERSION = "3.6.0"


def mitsuba(job: ExportJob) -> tex.Export:
    """NAME.xml, NAME_exact.xml, matcap_bsdf.py and the textures."""
    job.check_formats("Mitsuba", ("png", "jpg", "exr"), floats=True)
    textures = tex.standard_textures(job)
    exact_surface = partial(tex.standard_surface, textures)
    bare = float(job.picture("diffuse").max()) < _NO_DIFFUSE
    blend = {} if bare else _blend(job)
    names = tex.file_names(job.name, textures | blend)

    def surface(read: Reader) -> TargetSurface:
        if bare:
            return replace(exact_surface(read), shading=TargetShading(masking="separable"))
        share = read(blend["share"])
        return TargetSurface(
            read(blend["blend_diffuse"]) * (1.0 - share),
            read(blend["blend_specular"]) * share,
            read(textures["roughness"]),
            tex.signed(read(textures["normal_gl"])),
            f90=share,
            shading=TargetShading(masking="separable"),
        )

    exact = ET.Element("bsdf", type="matcap")
    _texture(exact, "diffuse", names["diffuse"], colour=True)
    _texture(exact, "specular", names["specular"], colour=job.coloured)
    _texture(exact, "roughness", names["roughness"])
    gloss = ET.Element("bsdf", type="principled")
    ET.SubElement(gloss, "float", name="metallic", value="1")
    mirrored = names["specular" if bare else "blend_specular"]
    _texture(gloss, "base_color", mirrored, colour=job.coloured)
    _texture(gloss, "roughness", names["roughness"])
    plain = gloss if bare else _blended(gloss, names)
    script = resources("matcap.export.scripts").joinpath(_SCRIPT).read_bytes()
    return tex.Export(
        tex.by_file(job.name, textures | blend),
        {
            f"{job.name}.xml": _scene(job, plain, names["normal_gl"]),
            f"{job.name}_exact.xml": _scene(job, exact, names["normal_gl"]),
            _SCRIPT: script,
        },
        {"metal" if bare else "blend": surface, "exact": exact_surface},
        (f"the residual is of {job.name}.xml; {job.name}_exact.xml with {_SCRIPT} has none",),
    )


def _blended(gloss: ET.Element, names: dict[str, str]) -> ET.Element:
    """A blendbsdf of diffuse and specular, weighted by the share texture."""
    plain = ET.Element("bsdf", type="blendbsdf")
    _texture(plain, "weight", names["share"])
    base = ET.SubElement(plain, "bsdf", type="diffuse")
    _texture(base, "reflectance", names["blend_diffuse"], colour=True)
    plain.append(gloss)
    return plain


def _blend(job: ExportJob) -> dict[str, TextureFile]:
    """Textures of the blend's share and of what it blends."""

    def diffuse(piece: MapRows) -> Picture:
        return piece.picture("diffuse") / (np.float32(1.0) - _share(piece))[..., None]

    def specular(piece: MapRows) -> Picture:
        f0, share = piece.picture("specular"), np.maximum(_share(piece), 1e-6)
        return (f0 / (share if f0.ndim == 2 else share[..., None])).astype(np.float32)

    of = partial(TextureFile.of, job)
    return {
        "share": of(_share, "16", "share of the blend that is specular"),
        "blend_diffuse": of(diffuse, "16", "diffuse / (1 - share)", srgb=True),
        "blend_specular": of(specular, "16", "F0 / share", srgb=job.coloured),
    }


def _share(piece: MapRows) -> Picture:
    """(H, W) specular share w: 1 - diffuse albedo, at least F0, at most _LARGEST_SHARE."""
    rest = 1.0 - piece.picture("diffuse").max(axis=-1)
    least = np.minimum(brightest_channel(piece.picture("specular")), _LARGEST_SHARE)
    return np.clip(rest, least, np.float32(_LARGEST_SHARE)).astype(np.float32)


def _scene(job: ExportJob, bsdf: ET.Element, normal: str) -> bytes:
    """The scene file: a rectangle from straight above, under one point light."""
    width, height = job.extent
    shrunk = min(1.0, _LARGEST_FILM / max(job.maps.size))
    pixels = [max(1, round(side * shrunk)) for side in job.maps.size]
    distance = max(width, height) / 2.0 / math.tan(math.radians(22.5))
    light = NAMED_LIGHTS["top"]
    place, intensity = ", ".join(str(c) for c in light), exposing_intensity(light)
    scene = ET.fromstring(f"""<scene version="{_VERSION}">
        <default name="spp" value="4"/>
        <integrator type="direct">
            <integer name="emitter_samples" value="1"/>
            <integer name="bsdf_samples" value="0"/>
        </integrator>
        <sensor type="perspective">
            <float name="fov" value="45"/>
            <string name="fov_axis" value="larger"/>
            <transform name="to_world">
                <lookat origin="0, 0, {distance!r}" target="0, 0, 0" up="0, 1, 0"/>
            </transform>
            <film type="hdrfilm">
                <integer name="width" value="{pixels[0]}"/>
                <integer name="height" value="{pixels[1]}"/>
                <rfilter type="box"/>
            </film>
            <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        </sensor>
        <emitter type="point">
            <point name="position" value="{place}"/>
            <rgb name="intensity" value="{intensity!r}"/>
        </emitter>
        <shape type="rectangle">
            <transform name="to_world">
                <scale x="{width / 2.0!r}" y="{height / 2.0!r}"/>
            </transform>
        </shape>
    </scene>""")
    # Mitsuba's shadowing term for normal maps has no counterpart in matcap.
    bent = ET.SubElement(scene[-1], "bsdf", type="normalmap")
    ET.SubElement(bent, "boolean", name="use_shadowing_function", value="false")
    ET.SubElement(bent, "boolean", name="flip_invalid_normals", value="false")
    _texture(bent, "normalmap", normal)
    bent.append(bsdf)
    ET.indent(scene)
    return ET.tostring(scene, encoding="utf-8") + b"\n"


def _texture(parent: ET.Element, name: str, file: str, *, colour: bool = False) -> None:
    """Add a bitmap texture; only integer colours are sRGB-encoded."""
    texture = ET.SubElement(parent, "texture", type="bitmap", name=name)
    ET.SubElement(texture, "string", name="filename", value=file)
    raw = "false" if colour and file.endswith((".png", ".jpg")) else "true"
    ET.SubElement(texture, "boolean", name="raw", value=raw)
    # By default ("auto") Mitsuba keeps integers of 16 bits as half floats, which have 11.
    ET.SubElement(texture, "string", name="format", value="variant")
    # Mitsuba maps a picture's first row to v = 0, the rectangle's lower border.
    ET.SubElement(ET.SubElement(texture, "transform", name="to_uv"), "scale", x="1", y="-1")


# Export to Blender: textures, and a script that builds the material from them.
#
# The script is the same for every material (scripts/blender_material.py) and reads the sidecar
# NAME_blender.json. In Cycles the material has matcap's reflectance; Eevee approximates it. Plane
# and displacement are in metres, Blender's unit.


def blender(job: ExportJob) -> tex.Export:
    """NAME_blender.py and its textures."""
    textures = tex.standard_textures(job)
    script = resources("matcap.export.scripts").joinpath("blender_material.py").read_bytes()
    return tex.Export(
        tex.by_file(job.name, textures),
        {f"{job.name}_blender.py": script},
        {"exact": partial(tex.standard_surface, textures)},
        ("needs Blender 4.3 or later, and Cycles for the exact reflectance", *job.size_notes()),
        {"textures": tex.file_names(job.name, textures)} | tex.height_entry(job, 1.0, 0.0),
    )
