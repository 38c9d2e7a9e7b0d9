"""F0 with a colour: what of it is sent to the page, and that the page draws it as relight does."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import torch
from example.exemplars import an_example
from four_metals import METALS, metal, repeated, side_by_side
from materials import a_material
from shown import STEP, WIDTH, around, expected, inner, picture, room_light  # fmt: skip

from matcap.example.example import Example
from matcap.field.plane import Rectangle
from matcap.view.document import packed_tile, sealed_page
from matcap.view.level_of_detail import ExemplarAverages
from matcap.view.subject import APRON, MIPS, PAGE_HEIGHT, Maps, Pages, Place, open_subject
from matcap.view.subject import WIDTH as PAGE_WIDTH

testclient = pytest.importorskip("starlette.testclient", reason="extra 'view' not installed")
pytest.importorskip("uvicorn", reason="extra 'view' not installed")
server = import_module("matcap.view.server")

ADDRESS = server.Address(8123, "secret-token")
HIGH, GRAZING = (-0.25, 0.2, 1.0), (-0.9, 0.3, 0.15)


def coloured(maps):
    """Maps of one F0 with the same one thrice."""
    return replace(maps, specular=maps.specular.expand(3, -1, -1))


def golden_exemplar():
    """The exemplar of the other tests, with an F0 of its own in every channel."""
    exemplar = an_example().exemplar
    grey = exemplar.specular
    return replace(exemplar, specular=np.concatenate([7 * grey, 5 * grey, 2 * grey]))


def golden():
    return a_material("golden", example=Example.of(golden_exemplar()))


def first_page(subject, **where):
    pages = Pages(subject, workers=1)
    try:
        return pages.ask(Place(0, 0, 0, **where)).result()
    finally:
        pages.close()


# What is sent.


def test_a_coloured_page_is_the_grey_one_with_green_and_blue_after_each_level():
    """Of three times the same F0 all else is as it was, byte for byte."""
    maps = metal("gold", 48, 32)
    grey = first_page(Maps(replace(maps, specular=maps.specular[:1]), "grey"))
    page = first_page(Maps(maps, "gold"))
    assert (grey.specular_channels, page.specular_channels) == (1, 3)
    before, at = 0, 0
    for mip in range(MIPS):
        count = (PAGE_WIDTH + 2 * APRON >> mip) * (PAGE_HEIGHT + 2 * APRON >> mip)
        size = 28 * count
        assert page.data[at : at + size] == grey.data[before : before + size]
        before, at = before + size, at + size
        rest = np.frombuffer(page.data[at : at + 4 * count], "<f2").reshape(-1, 2)
        if mip == 0:
            rows, columns = np.arange(-8, 248) % 32, np.arange(-8, 504) % 48
            wanted = maps.specular[1:, rows][:, :, columns].movedim(0, -1).reshape(-1, 2)
            assert np.abs(rest - wanted.numpy()).max() <= 2**-11
        at += 4 * count
    assert (before, at) == (len(grey.data), len(page.data))
    low, high = page.ends[0]
    assert (low, high) == (pytest.approx(0.34), pytest.approx(1.0))


@pytest.mark.parametrize(("channels", "size"), [(1, 28), (3, 32)])
def test_the_header_says_how_many_channels(channels, size):
    maps = metal("copper", 48, 32)
    pages = Pages(Maps(replace(maps, specular=maps.specular[:channels]), "copper"), workers=1)
    client = testclient.TestClient(
        server.make_app(pages, ADDRESS), base_url="http://127.0.0.1:8123"
    )
    answer = client.get(f"/{ADDRESS.token}/page", params={"level": 1, "column": 0, "row": 0})
    pages.close()
    assert json.loads(answer.headers["x-page"])["specular_channels"] == channels
    texels = sum((512 >> mip) * (256 >> mip) for mip in range(MIPS))
    assert len(answer.content) == size * texels


def test_each_channel_is_averaged_by_itself():
    """From afar, of the exemplar, and of what the page shows before there is any."""
    maps = metal("rust beside steel", 50, 30)
    red, blue = (replace(maps, specular=maps.specular[c : c + 1]) for c in (0, 2))
    for level in (0, 1, 4):
        whole, one, other = (
            Maps(of, "metal").moments(level, Rectangle(3, -2, 4, 3), seed=0, share=0.0)[0]
            for of in (maps, red, blue)
        )
        assert (len(whole), len(one)) == (11, 9)
        assert np.array_equal(np.delete(whole, (4, 5), 0), one)
        assert np.array_equal(np.delete(whole, (3, 4), 0), other)
    assert np.delete(Maps(maps, "metal").facts.mean, (4, 5)) == pytest.approx(
        Maps(red, "metal").facts.mean
    )
    exemplar = golden_exemplar()
    alone = replace(exemplar, specular=exemplar.specular[1:2])
    places = np.stack(np.meshgrid(np.arange(9), np.arange(7)), axis=-1) * 8
    for level in (2, 9):
        found, wanted = (ExemplarAverages(of).read(level, places) for of in (exemplar, alone))
        np.testing.assert_allclose(np.delete(found, (3, 5), 0), wanted, rtol=1e-6)


def test_the_tile_inside_a_document_says_how_many_channels():
    maps = metal("blue anodised", 48, 32)
    tile, grey = (packed_tile(of) for of in (maps, replace(maps, specular=maps.specular[:1])))
    assert (tile["specular_channels"], grey["specular_channels"]) == (3, 1)


# What is drawn.


@pytest.mark.parametrize(("lamp", "exposure"), [(HIGH, 0.0), (GRAZING, 3.0)], ids=["high", "low"])
@pytest.mark.parametrize(
    ("shape", "span"), [("plane", WIDTH), ("plane", 2.5 * WIDTH), ("sphere", 2 * WIDTH)]
)
def test_metals_equal_those_of_relight(metals_tab, shape, span, lamp, exposure):
    shown = picture(metals_tab, shape=shape, x=0, y=0, span=span, lamp=lamp, exposure=exposure)
    wanted, seen = expected(repeated(side_by_side()), shape, span, exposure, lamp=lamp)
    assert np.ptp(wanted[seen], axis=1).max() > 60 * STEP  # colours there are
    assert np.abs(shown - wanted)[inner(seen)].max() <= 2 * STEP


@pytest.fixture(scope="module")
def metals_tab(served, shared_tab):
    with served(Maps(side_by_side(), "metals")) as address:
        yield shared_tab(address.url)


def test_an_environment_in_metals_equals_that_of_relight(metals_tab, tmp_path):
    shown = picture(metals_tab, shape="sphere", x=0, y=0, span=2 * WIDTH, light="studio",
                    lamp=[-0.35, 0.3, 1])  # fmt: skip
    lights = room_light(metals_tab, "studio", tmp_path / "room.exr")
    wanted, seen = expected(repeated(side_by_side()), "sphere", 2 * WIDTH, lights=lights)
    off = np.abs(shown - wanted)[inner(seen, 4)]
    assert off.mean() <= 2 * STEP and np.quantile(off, 0.99) <= 8 * STEP


def test_the_map_of_f0_has_its_colour(metals_tab):
    shown = picture(metals_tab, map="specular", x=0, y=0, span=WIDTH)
    low, high = metals_tab.ask("matcap.view.range()")
    values = side_by_side().specular.movedim(0, -1).numpy()
    rows, columns = np.arange(-120, 120) % 240, np.arange(-160, 160) % 320
    wanted = (values[rows][:, columns] - low) / (high - low)
    assert (low, high) == (pytest.approx(values.min()), pytest.approx(values.max()))
    assert np.abs(shown - wanted).max() <= 1.01 * STEP


@pytest.mark.parametrize("channels", [1, 3])
def test_where_there_is_no_page_yet_f0_is_the_mean(tab, served, channels):
    maps = metal("copper", 48, 32)
    with served(Maps(replace(maps, specular=maps.specular[:channels]), "copper")) as address:
        page = tab(address.url)
        page.loaded()
        result = page.ask("""["meanDiffuse", "meanF0", "meanSurface"].flatMap((name) => {
          const { gl, places } = matcap.view;
          return [...gl.getUniform(gl.getParameter(gl.CURRENT_PROGRAM), places[name])];
        })""")
    *_, alpha2, _, _, squares, _ = Maps(maps, "copper").facts.mean
    f0 = METALS["copper"] if channels == 3 else METALS["copper"][:1] * 3
    assert result == pytest.approx([0, 0, 0, *f0, alpha2, 0, 0, squares])


def test_three_equal_channels_equal_one(tab, served):
    """To the bit: the shader takes one way for both."""
    maps = metal("rust beside steel", 96, 64)
    grey = replace(maps, specular=maps.specular[:1])
    states = [{"light": "studio"}, {"shape": "sphere", "lamp": HIGH}, {"map": "specular"}]
    found = []
    for one in (grey, coloured(grey)):
        with served(Maps(one, "steel")) as address:
            page = tab(address.url)
            found.append([picture(page, span=200, **state) for state in states])
    assert np.array_equal(*found)


def test_an_enclosed_page_draws_metals_as_well(tab, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(sealed_page(Maps(side_by_side(), "metals")), encoding="utf-8")
    page = tab(path.as_uri())
    shown = picture(page, x=0, y=0, span=WIDTH, lamp=GRAZING, exposure=3)
    wanted, _ = expected(repeated(side_by_side()), "plane", WIDTH, 3, lamp=GRAZING)
    assert np.abs(shown - wanted).max() <= 2 * STEP and page.shown() == []


def test_an_endless_field_from_its_file_and_enclosed(tab, served, tmp_path):
    material = golden()
    material.save(tmp_path / "golden.matcap")
    subject = open_subject(tmp_path / "golden.matcap")
    assert len(material.maps(8, 8).specular) == 3
    with served(subject) as address:
        shown = picture(tab(address.url), x=256, y=256, span=WIDTH, lamp=HIGH)
    wanted, _ = expected(around(material, 256, 256), "plane", WIDTH, lamp=HIGH)
    assert np.abs(shown - wanted).max() <= 2 * STEP
    path = tmp_path / "page.html"
    path.write_text(sealed_page(subject, 256), encoding="utf-8")
    shown = picture(tab(path.as_uri()), x=0, y=0, span=WIDTH, lamp=HIGH)
    wanted, _ = expected(around(material, 0, 0, period=(256, 256)), "plane", WIDTH, lamp=HIGH)
    assert np.abs(shown - wanted).max() <= 2 * STEP


def test_four_metals_have_their_f0():
    for name, base in METALS.items():
        maps = metal(name, 48, 32)
        assert maps.specular.flatten(1).amax(dim=1).tolist() == pytest.approx(base)
        assert not maps.diffuse.any() or name == "rust beside steel"
    assert torch.equal(metal("gold", 48, 32).stacked(), metal("gold", 48, 32).stacked())
