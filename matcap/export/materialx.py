"""A MaterialX 1.39 document with matcap's own reflectance.

A Lambertian diffuse and a `generalized_schlick_bsdf` are added, not layered: matcap's diffuse
albedo is what is seen beside the specular part. Roughness is squared to alpha, as GGX takes it,
and the height moves the surface by its real size. MaterialX's renderers add what bounces between
microfacets to the specular part, which matcap leaves out: brighter by up to some ten per cent where
F0 and roughness are both high.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from matcap.export.textures import Export, ExportJob, Standard

_VERSION = "1.39"


def materialx(job: ExportJob) -> Export:
    """NAME.mtlx beside its textures."""
    textures = Standard.of(job)
    files = textures.files(job.name)
    document = _document(job, *files)
    return Export(dict(files), {f"{job.name}.mtlx": document}, textures.surface())


def _document(
    job: ExportJob, diffuse: str, specular: str, roughness: str, normal: str, height: str
) -> bytes:
    """The .mtlx file; names of the five textures."""
    root = ET.Element("materialx", version=_VERSION, colorspace="lin_rec709")
    graph = ET.SubElement(root, "nodegraph", name="NG_matcap")

    def image(name: str, kind: str, file: str, space: str | None = None) -> None:
        node = _node(graph, "image", name, kind)
        source = ET.SubElement(node, "input", name="file", type="filename", value=file)
        if space:
            source.set("colorspace", space)

    # PNGs of colour carry the sRGB curve; EXR textures hold light, like the document.
    image("diffuse", "color3", diffuse, "srgb_texture" if diffuse.endswith(".png") else None)
    image("specular", "float", specular)
    image("roughness", "float", roughness)
    image("normal_texture", "vector3", normal)
    image("height", "float", height)
    normal_map = _node(graph, "normalmap", "normal", "vector3")
    _link(normal_map, "in", "vector3", "normal_texture")
    base = _node(graph, "oren_nayar_diffuse_bsdf", "diffuse_bsdf", "BSDF")
    _link(base, "color", "color3", "diffuse")
    _value(base, "roughness", "float", "0")
    _link(base, "normal", "vector3", "normal")
    f0 = _node(graph, "convert", "f0", "color3")
    _link(f0, "in", "float", "specular")
    alpha = _node(graph, "roughness_anisotropy", "alpha", "vector2")
    _link(alpha, "roughness", "float", "roughness")
    _value(alpha, "anisotropy", "float", "0")
    gloss = _node(graph, "generalized_schlick_bsdf", "specular_bsdf", "BSDF")
    _link(gloss, "color0", "color3", "f0")
    _value(gloss, "color82", "color3", "1, 1, 1")
    _value(gloss, "color90", "color3", "1, 1, 1")
    _value(gloss, "exponent", "float", "5")
    _link(gloss, "roughness", "vector2", "alpha")
    _link(gloss, "normal", "vector3", "normal")
    _value(gloss, "distribution", "string", "ggx")
    _value(gloss, "scatter_mode", "string", "R")
    both = _node(graph, "add", "bsdf", "BSDF")
    _link(both, "in1", "BSDF", "diffuse_bsdf")
    _link(both, "in2", "BSDF", "specular_bsdf")
    surface = _node(graph, "surface", "lit", "surfaceshader")
    _link(surface, "bsdf", "BSDF", "bsdf")
    width, tall = (side * job.unit_length for side in job.extent)
    note = f"One tile is {width:.6g} x {tall:.6g} {job.unit}; heights are moved to the same unit."
    moved = _node(graph, "displacement", "moved", "displacementshader")
    moved.set("doc", note)
    _link(moved, "displacement", "float", "height")
    _value(moved, "scale", "float", repr(job.unit_length))
    for name, kind, node in (
        ("surface_out", "surfaceshader", "lit"),
        ("displacement_out", "displacementshader", "moved"),
    ):
        ET.SubElement(graph, "output", name=name, type=kind, nodename=node)
    material = _node(root, "surfacematerial", "M_matcap", "material")
    for name, kind, output in (
        ("surfaceshader", "surfaceshader", "surface_out"),
        ("displacementshader", "displacementshader", "displacement_out"),
    ):
        ET.SubElement(material, "input", name=name, type=kind, nodegraph="NG_matcap", output=output)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _node(parent: ET.Element, category: str, name: str, kind: str) -> ET.Element:
    return ET.SubElement(parent, category, name=name, type=kind)


def _link(node: ET.Element, name: str, kind: str, source: str) -> None:
    ET.SubElement(node, "input", name=name, type=kind, nodename=source)


def _value(node: ET.Element, name: str, kind: str, value: str) -> None:
    ET.SubElement(node, "input", name=name, type=kind, value=value)
