"""MaterialX 1.39 documents: one with matcap's reflectance, two for the standard shaders.

NAME.mtlx adds a Lambertian lobe and a `generalized_schlick_bsdf` with alpha = roughness^2.
MaterialX's renderers add multiple scattering to it, which matcap leaves out: up to about 10 %
brighter where F0 and roughness are both high.

NAME_openpbr.mtlx and NAME_standard_surface.mtlx are for programs, such as Unreal, that read only
`open_pbr_surface` and `standard_surface`. Both layer the specular lobe over the diffuse one; the
base colour compensates for the layer's darkening (workflows.py).

All displace by the height, in metres if the size was measured.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from matcap.export import textures as tex
from matcap.export import workflows
from matcap.export.gltf import ior
from matcap.export.job import ExportJob, MapRows, Picture
from matcap.export.presets import EngineModel
from matcap.export.shading import MadeSurface, Reader, TargetShading, TargetSurface, nearest
from matcap.export.texture_file import TextureFile

VERSION = "1.39"
# Indices of refraction that are tried, by their F0.
_INDICES = (0.04, 0.08, 0.12, 0.2, 0.3, 0.5, 0.9, 0.995)
_LEAST_INDEX = 0.02  # least F0 of the dielectric in the metallic workflow


def materialx(job: ExportJob) -> tex.Export:
    """NAME.mtlx, NAME_openpbr.mtlx and NAME_standard_surface.mtlx and their textures."""
    job.check_formats("MaterialX", ("png", "jpg", "exr"), floats=True)
    textures = tex.standard_textures(job)
    standard = tex.by_file(job.name, textures)
    layered = {shader: Layered.of(job, shader) for shader in INPUTS}
    # If both shaders take the same kind of textures, they share them.
    stems = dict.fromkeys(INPUTS, job.name)
    if len({one.kind for one in layered.values()}) > 1:
        stems["standard_surface"] += "_standard"
    else:
        layered["standard_surface"] = layered["open_pbr_surface"]
    textures_of = {shader: one.files(stems[shader]) for shader, one in layered.items()}
    documents: dict[str, bytes | Callable[[Path], bytes]] = {
        f"{job.name}.mtlx": _exact(job, standard)
    }
    surfaces: dict[str, MadeSurface] = {"exact": partial(tex.standard_surface, textures)}
    for shader, label in (("open_pbr_surface", "openpbr"), ("standard_surface",) * 2):
        files = textures_of[shader] | dict(list(standard.items())[2:])
        documents[f"{job.name}_{label}.mtlx"] = _layered(job, files, shader, layered[shader])
        surfaces[shader] = partial(layered[shader].surface, textures, shader=shader)
    return tex.Export(
        standard | textures_of["open_pbr_surface"] | textures_of["standard_surface"],
        documents,
        surfaces,
        (*workflows.clipping_notes(job, layered["open_pbr_surface"].shading), *job.size_notes()),
    )


@dataclass(frozen=True)
class Layered:
    """The two textures of shaders that layer a specular lobe over a diffuse one.

    Either exact Fresnel of one index of refraction for all texels, tinted down to each one's F0
    (higher indices are closer to Schlick's curve). Or, for metals, the metallic workflow: Fresnel
    of a dielectric's index, and metal with the base colour as F0.
    """

    base: TextureFile
    second: TextureFile
    """Tint of the specular lobe, or metalness."""
    kind: Literal["tint", "metalness"]
    """Which of them."""
    shading: TargetShading
    """Shading model of the shaders."""

    @staticmethod
    def of(job: ExportJob, shader: str = "open_pbr_surface") -> Layered:
        """The variant (index of refraction, or metalness) with the smallest residual."""
        # Least F0 of the index: the largest of the maps.
        least = float(np.clip(job.picture("specular").max(), _INDICES[0], _INDICES[-1]))
        indices = (least, *(index for index in _INDICES if index > least))
        tried = [Layered.at(job, index) for index in indices]
        if float(job.picture("specular").max()) >= workflows.FIRST_METAL:
            tried.append(Layered.metallic(job))
        standard = tex.standard_textures(job)
        return tried[nearest(job, [partial(one.surface, standard, shader=shader) for one in tried])]

    @staticmethod
    def at(job: ExportJob, index: float) -> Layered:
        """The tinted variant, with the index of refraction whose F0 is `index`."""
        shading = TargetShading(layer="albedo", compensated=True, index=index)

        def tint(piece: MapRows) -> Picture:
            return np.clip(workflows.specular_colour(piece, shading) / np.float32(index), 0.0, 1.0)

        return Layered(
            TextureFile.of(
                job, lambda piece: workflows.base_colour(piece, shading), "16", tex.BASE, srgb=True
            ),
            TextureFile.of(job, tint, "16", f"F0 / {index:g}", srgb=job.coloured),
            "tint",
            shading,
        )

    @staticmethod
    def metallic(job: ExportJob) -> Layered:
        """The metallic variant: base colour and metalness by to_metallic()."""
        textures = EngineModel(TargetShading(), "metallic", even=_INDICES[0]).of(job)
        index = max(textures.dielectric[0], _LEAST_INDEX)
        shading = TargetShading(layer="albedo", compensated=True, index=index)

        def made(piece: MapRows) -> workflows.Metallic:
            f0, rough = piece.picture("specular"), piece.picture("roughness")
            diffuse = workflows.base_colour(piece, shading)
            shown = np.clip(
                workflows.fitted_tables(replace(shading, index=None)).f0(f0, rough), 0.0, 1.0
            )
            return workflows.to_metallic(
                workflows.MetallicAim(diffuse, shown, rough, index, index), "free"
            )

        return Layered(
            TextureFile.of(job, lambda piece: made(piece).base, "16", tex.BASE, srgb=True),
            TextureFile.of(job, lambda piece: made(piece).metallic, "16", "metalness"),
            "metalness",
            shading,
        )

    @property
    def ior(self) -> float:
        """The index of refraction."""
        return ior(self.shading.index or 0.0)

    def files(self, name: str) -> dict[str, TextureFile]:
        """Both textures by file name."""
        label = "specular_color" if self.kind == "tint" else "base_metalness"
        return tex.by_file(name, {"base_color": self.base, label: self.second})

    def surface(
        self, others: Mapping[str, TextureFile], read: Reader, shader: str = "open_pbr_surface"
    ) -> TargetSurface:
        """The reflectance that a shader renders, with roughness and normal_gl of `others`."""
        base, second = read(self.base), read(self.second)
        rest = read(others["roughness"]), tex.signed(read(others["normal_gl"]))
        index = self.shading.index or 0.0
        if self.kind == "tint":
            f0 = second * index
            return TargetSurface(base, f0, *rest, layer=f0, shading=self.shading)
        f0 = torch.full_like(second, index)
        shading = replace(self.shading, conductor=shader == "standard_surface")
        diffuse = base * (1.0 - second)
        return TargetSurface(
            diffuse, f0, *rest, layer=f0, shading=shading, metal=base, share=second
        )


class _Document:
    """Builds a document with one node graph of textures and one material.

    Args:
        files: the five textures in order; the last are roughness, normal and height.
        first: names and types of the first two images.
    """

    def __init__(
        self, job: ExportJob, files: dict[str, TextureFile], *first: tuple[str, str]
    ) -> None:
        self.job = job
        self.root = ET.Element("materialx", version=VERSION, colorspace="lin_rec709")
        self.graph = ET.SubElement(self.root, "nodegraph", name="NG_matcap")
        *textures, height = files.items()
        images = (*first, ("roughness", "float"), ("normal_texture", "vector3"))
        for (name, kind), (file, texture) in zip(images, textures, strict=True):
            self.image(name, kind, file, texture)
        self.displaced(*height)
        _node(self.graph, "normalmap normal vector3", "in vector3 @normal_texture")

    def image(self, name: str, kind: str, file: str, texture: TextureFile) -> None:
        """Add an image node; its colour space is raw for data."""
        node = _node(self.graph, f"image {name} {kind}")
        space = "srgb_texture" if texture.colour_space == "sRGB" else "lin_rec709"
        made = ET.SubElement(node, "input", name="file", type="filename", value=file)
        made.set("colorspace", space if texture.srgb else "raw")

    def colour(self, name: str, image: str) -> str:
        """Name of a node with F0 as color3: the image, or if it is grey a conversion, `name`."""
        if self.job.coloured:
            return image
        _node(self.graph, f"convert {name} color3", f"in float @{image}")
        return name

    def displaced(self, file: str, texture: TextureFile) -> None:
        """Add the height image and a displacement node."""
        job, graph = self.job, self.graph
        self.image("height", "float", file, texture)
        width, tall = (side * job.unit_length for side in job.extent)
        shader = "displacement moved displacementshader"
        moved = _node(graph, shader, "displacement float @height")
        moved.set("doc", f"One tile is {width:.6g} x {tall:.6g} {job.unit}.")
        scale = _value(moved, "scale", "float", repr(job.metres))
        if job.millimetres is not None:
            scale.set("unittype", "distance")
            scale.set("unit", "meter")
        _output(graph, "displacement_out", "displacementshader", "moved")

    def material(self, **surface: str) -> bytes:
        """Add the material and return the file; `surface` are attributes that name its surface."""
        material = _node(self.root, "surfacematerial M_matcap material")
        kind = "surfaceshader"
        ET.SubElement(material, "input", {"name": kind, "type": kind, **surface})
        _graph_link(material, "displacementshader", "displacementshader", "displacement_out")
        ET.indent(self.root)
        return ET.tostring(self.root, encoding="utf-8", xml_declaration=True) + b"\n"


def _exact(job: ExportJob, files: dict[str, TextureFile]) -> bytes:
    """The .mtlx file with matcap's reflectance; `files` are the five textures in order."""
    second = ("specular", "color3" if job.coloured else "float")
    made = _Document(job, files, ("diffuse", "color3"), second)
    _node(
        made.graph, "oren_nayar_diffuse_bsdf diffuse_bsdf BSDF",
        "color color3 @diffuse", "roughness float 0", "normal vector3 @normal",
    )  # fmt: skip
    f0 = made.colour("f0", "specular")
    alpha = "roughness float @roughness", "anisotropy float 0"
    _node(made.graph, "roughness_anisotropy alpha vector2", *alpha)
    _node(
        made.graph, "generalized_schlick_bsdf specular_bsdf BSDF",
        f"color0 color3 @{f0}", "color82 color3 1, 1, 1", "color90 color3 1, 1, 1",
        "exponent float 5", "roughness vector2 @alpha", "normal vector3 @normal",
        "distribution string ggx", "scatter_mode string R",
    )  # fmt: skip
    _node(made.graph, "add bsdf BSDF", "in1 BSDF @diffuse_bsdf", "in2 BSDF @specular_bsdf")
    _node(made.graph, "surface lit surfaceshader", "bsdf BSDF @bsdf")
    _output(made.graph, "surface_out", "surfaceshader", "lit")
    return made.material(nodegraph="NG_matcap", output="surface_out")


def _inputs(metalness: str, ior: str, normal: str) -> dict[str, tuple[str, str]]:
    return {
        "base_color": ("base_color", "color3"),
        "tint": ("specular_color", "color3"),
        "metalness": (metalness, "float"),
        "roughness": ("specular_roughness", "float"),
        "ior": (ior, "float"),
        "normal": (normal, "vector3"),
    }


# Names and types of the shaders' inputs.
INPUTS = {
    "open_pbr_surface": _inputs("base_metalness", "specular_ior", "geometry_normal"),
    "standard_surface": _inputs("metalness", "specular_IOR", "normal"),
}


def _layered(job: ExportJob, files: dict[str, TextureFile], shader: str, layered: Layered) -> bytes:
    """The .mtlx file of a standard shader; `files` are the five textures in order."""
    kind, second = layered.kind, ("metalness", "float")
    if kind == "tint":
        second = ("f0", "color3" if job.coloured else "float")
    made = _Document(job, files, ("base_color", "color3"), second)
    sources = {"tint": made.colour("tint", "f0")} if kind == "tint" else {}
    inputs = INPUTS[shader]
    ones = ("base float 1", "specular float 1") if shader == "standard_surface" else ()
    surface = _node(made.root, f"{shader} lit surfaceshader", *ones)
    for name in ("base_color", kind, "roughness", "normal"):
        input_, type_ = inputs[name]
        _output(made.graph, f"{name}_out", type_, sources.get(name, name))
        _graph_link(surface, input_, type_, f"{name}_out")
    _value(surface, inputs["ior"][0], "float", repr(layered.ior))
    return made.material(nodename="lit")


def _node(parent: ET.Element, node: str, *inputs: str) -> ET.Element:
    """Add a node, "CATEGORY NAME TYPE", with inputs "NAME TYPE VALUE"; @NAME links to a node."""
    category, name, kind = node.split()
    made = ET.SubElement(parent, category, name=name, type=kind)
    for one in inputs:
        _value(made, *one.split(maxsplit=2))
    return made


def _output(graph: ET.Element, name: str, kind: str, source: str) -> None:
    ET.SubElement(graph, "output", name=name, type=kind, nodename=source)


def _graph_link(node: ET.Element, name: str, kind: str, output: str) -> None:
    """Link an input to an output of the node graph."""
    ET.SubElement(node, "input", name=name, type=kind, nodegraph="NG_matcap", output=output)


def _value(node: ET.Element, name: str, kind: str, value: str) -> ET.Element:
    given = {"nodename": value[1:]} if value.startswith("@") else {"value": value}
    return ET.SubElement(node, "input", {"name": name, "type": kind, **given})
