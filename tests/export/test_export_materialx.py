"""The document through MaterialX's own library."""

import json

import numpy as np
import pytest
from exported import MATERIALS, channels, linear, picture

from matcap.export.surface import Surface, residual
from matcap.export.targets import write_export
from matcap.export.textures import Job


@pytest.fixture
def mx():
    return pytest.importorskip("MaterialX", reason="needs the extra `export`")


@pytest.fixture
def load(mx):
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)

    def read(path):
        document = mx.createDocument()
        document.importLibrary(library)
        mx.readFromXmlFile(document, str(path))
        return document

    return read


@pytest.mark.parametrize("name", MATERIALS)
def test_it_is_valid(tmp_path, made, load, name):
    write_export(Job(made[name], name, millimetres=90.0), "materialx", tmp_path)
    assert load(tmp_path / f"{name}.mtlx").validate() == (True, "")


def test_the_validator_would_object(tmp_path, made, load):
    write_export(Job(made["leather"], "leather"), "materialx", tmp_path)
    file = tmp_path / "leather.mtlx"
    file.write_text(file.read_text().replace('nodename="alpha"', 'nodename="alfa"'))
    assert not load(file).validate()[0]


def test_a_shader_can_be_made_of_it(tmp_path, made, load, mx):
    from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader

    write_export(Job(made["leather"], "leather"), "materialx", tmp_path)
    document = load(tmp_path / "leather.mtlx")
    generator = PyMaterialXGenGlsl.EsslShaderGenerator.create()
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    (element,) = PyMaterialXGenShader.findRenderableElements(document)
    shader = generator.generate("leather", element, context)
    code = shader.getSourceCode(PyMaterialXGenShader.PIXEL_STAGE)
    assert "mx_generalized_schlick_bsdf(" in code
    assert "mx_layer" not in code


@pytest.mark.parametrize("name", MATERIALS)
def test_its_graph_gives_the_light_of_the_maps(tmp_path, made, load, name):
    """Walks the document: every input found by following its links, none by file names."""
    write_export(Job(made[name], name), "materialx", tmp_path)
    document = load(tmp_path / f"{name}.mtlx")
    graph = document.getNodeGraph("NG_matcap")
    surface = graph.getOutput("surface_out").getConnectedNode()
    both = surface.getConnectedNode("bsdf")
    assert both.getCategory() == "add"
    base, gloss = (both.getConnectedNode(name) for name in ("in1", "in2"))
    assert base.getCategory() == "oren_nayar_diffuse_bsdf"
    assert gloss.getCategory() == "generalized_schlick_bsdf"
    for input_, value in (("color82", "1, 1, 1"), ("color90", "1, 1, 1"), ("exponent", "5")):
        assert gloss.getInput(input_).getValueString() == value

    def read(node):
        file = node.getInput("file")
        coded = picture(tmp_path / file.getValueString())
        return linear(coded) if file.getColorSpace() == "srgb_texture" else coded

    alpha = gloss.getConnectedNode("roughness")
    assert alpha.getCategory() == "roughness_anisotropy"  # the square, MaterialX says
    bent = gloss.getConnectedNode("normal")
    assert bent.getName() == base.getConnectedNode("normal").getName()
    seen = Surface(
        channels(read(base.getConnectedNode("color"))),
        channels(read(gloss.getConnectedNode("color0").getConnectedNode("in"))),
        channels(read(alpha.getConnectedNode("roughness"))),
        channels(2.0 * read(bent.getConnectedNode("in")) - 1.0),
    )
    assert residual(made[name], seen).worst < 1e-3


@pytest.mark.parametrize(("unit", "scale"), [(None, 1.0), (85.0, 85.0)])
def test_heights_are_real(tmp_path, made, load, unit, scale):
    from matcap.export.exr import read_exr

    write_export(Job(made["leather"], "leather", unit), "materialx", tmp_path)
    document = load(tmp_path / "leather.mtlx")  # its elements live no longer than it does
    graph = document.getNodeGraph("NG_matcap")
    lift = graph.getOutput("displacement_out").getConnectedNode()
    assert lift.getInput("scale").getValue() == scale
    file = lift.getConnectedNode("displacement").getInput("file").getValueString()
    assert np.array_equal(read_exr(tmp_path / file)[..., 0], made["leather"].height[0])
    sidecar = json.loads((tmp_path / "leather_materialx.json").read_text())
    assert sidecar["unit"] == ("mm" if unit else "plane unit")
    assert sidecar["tile"][0] == pytest.approx(2.0 * scale)
