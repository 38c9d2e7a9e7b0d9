"""A folder of materials: what is on its shelf, what its server answers, what its page does."""

import json

import numpy as np
import pytest
from materials import a_material

from matcap.cli.main import main
from matcap.view.library import Library, find_library, numbers
from matcap.view.pages import Pages
from matcap.view.subject import open_subject

testclient = pytest.importorskip("starlette.testclient", reason="extra 'view' not installed")
server = pytest.importorskip("matcap.view.server")

# The three that can be, and the broken one known to be.
SHOWN = (
    "!!window.matcap && matcap.shelf.pages.held.size === 3 && !!document.querySelector('.broken')"
)
ADDRESS = server.Address(8123, "secret-token")


@pytest.fixture(scope="module")
def shoot(tmp_path_factory):
    """What a batch leaves, as far as the page is concerned; one file of it is broken."""
    folder = tmp_path_factory.mktemp("shoot")
    for seed, name in enumerate(("brick", "cloth", "moss")):
        (folder / name).mkdir()
        a_material(name, seed).save(folder / name / f"{name}.matcap")
    result = {"verdict": {"rating": "good", "sentence": "Nothing speaks against it."}}
    (folder / "cloth" / "report.json").write_text(json.dumps(result))
    (folder / "torn").mkdir()
    (folder / "torn" / "torn.matcap").write_bytes(b"torn")
    return folder


@pytest.fixture(scope="module")
def library(shoot):
    return Library(find_library(shoot))


@pytest.fixture(scope="module")
def client(library):
    opened = []

    def pages(subject):
        opened.append(Pages(subject, workers=1))
        return opened[-1]

    app = server.make_library(library, "shoot", ADDRESS, pages)
    yield testclient.TestClient(app, base_url="http://127.0.0.1:8123")
    for one in opened:
        one.close()


def get(client, path, **query):
    return client.get(f"/{ADDRESS.token}/{path}", params=query)


def test_a_folder_of_captures_is_a_library_and_a_capture_is_none(shoot, library, tmp_path):
    assert [one["name"] for one in library.shelf()] == ["brick", "cloth", "moss", "torn"]
    assert [one["rating"] for one in library.shelf()] == ["", "good", "", ""]
    assert find_library(shoot / "moss") == []
    assert find_library(shoot / "moss" / "moss.matcap") == []
    assert find_library(tmp_path) == []
    assert open_subject(shoot / "moss").facts.name == "moss"


def test_the_shelf_and_each_materials_page(client):
    assert '"brick"' in get(client, "").text
    assert "</h1>" in get(client, "m/2/").text
    own = get(client, "m/2/page", level=0, column=3, row=1).content
    assert own != get(client, "m/1/page", level=0, column=3, row=1).content
    between = get(client, "m/1+2/page", level=0, column=3, row=1, share=1.0).content
    assert np.array_equal(np.frombuffer(between, "<u2"), np.frombuffer(own, "<u2"))
    assert get(client, "library.js").status_code == 200
    assert get(client, "m/2/main.js").status_code == 200
    assert len(get(client, "swatch", index=1).content) > 100_000


@pytest.mark.parametrize(
    "path",
    ["m/9/", "m/x/", "m/1+2+0/", "m/-1/", "m/1e1/", "m/99999999999999/", "swatch?index=9", "swatch",
     "brick"],
)  # fmt: skip
def test_what_is_not_there_is_not_found(client, path):
    assert client.get(f"/{ADDRESS.token}/{path}").status_code == 404


def test_without_the_token_nothing_is_given(client):
    for path in ("/m/0/", "/swatch?index=0", "/wrong/m/0/"):
        assert client.get(path).status_code == 403


def test_a_broken_material_is_one_sentence(client):
    for path in ("m/3/", "swatch?index=3"):
        answer = client.get(f"/{ADDRESS.token}/{path}")
        assert answer.status_code == 400 and "torn.matcap" in answer.text


def test_numbers():
    assert numbers("3", 4) == (3, None) and numbers("0+3", 4) == (0, 3)
    assert [numbers(name, 4) for name in ("4", "", "+", "1+", "-1", "\u0661")] == [None] * 6


@pytest.mark.parametrize("more", [["--seed", "3"], ["--html", "x.html"], ["--photo", "x.jpg"]])
def test_options_of_one_material_are_refused(shoot, more, capsys):
    assert main(["view", str(shoot), "--no-open", *more]) == 2
    assert "several materials" in capsys.readouterr().err


def test_spheres_follow_one_light_and_open_their_material(tab, served, library):
    with served(library) as address:
        page = tab(address.url)
        page.until(SHOWN, 120)
        page.complaints.clear()  # the browser's own words about the broken one
        ring = """(index) => {
          const { gl } = matcap.shelf, box = matcap.cards[index].face.getBoundingClientRect();
          matcap.shelf.draw(matcap.cards);
          const side = Math.round(box.width), codes = new Uint8Array(4 * side * side);
          gl.readPixels(box.left, gl.canvas.height - box.bottom, side, side, gl.RGBA,
            gl.UNSIGNED_BYTE, codes);
          const half = [0, 0];
          for (let i = 0; i < side * side; i++) half[i % side < side / 2 ? 0 : 1] += codes[4 * i];
          return half;
        }"""
        page.page.mouse.move(5, 150)
        left = page.ask(ring, 1)
        page.page.mouse.move(795, 150)
        right = page.ask(ring, 1)
        assert left[0] > left[1] and right[0] < right[1]
        page.page.fill("#find", "MOSS")
        assert page.page.inner_text("#status") == "1 of 4 materials"
        assert page.page.locator(".card:visible").count() == 1
        page.page.fill("#find", "")
        page.page.select_option("#rating", "good")
        assert page.page.locator(".card:visible .called").inner_text() == "cloth"
        page.page.select_option("#rating", "")
        stage = "matcap.shelf.gl.getParameter(matcap.shelf.gl.COLOR_CLEAR_VALUE)[0]"
        light = page.ask(stage)  # as the browser is
        page.page.click("#theme")
        page.until(f"{stage} < {light} - 0.3")
        page.page.focus(".card >> nth=2 >> a")
        page.page.keyboard.press("c")
        assert page.page.inner_text("#chosen").startswith("moss is chosen.")
        assert page.page.get_attribute(".card >> nth=2 >> button", "aria-pressed") == "true"
        page.page.keyboard.press("Escape")
        assert page.page.inner_text("#chosen") == "moss is let go."
        assert page.page.get_attribute(".card >> nth=2 >> button", "aria-pressed") == "false"
        page.page.keyboard.press("c")
        page.page.focus(".card >> nth=0 >> button")
        page.page.keyboard.press("Enter")
        page.page.wait_for_url("**/m/2+0/**")
        page.loaded()
        assert page.page.is_checked("input[name=left][value=second]")
        words = page.page.get_attribute("#wipe", "aria-valuetext")
        assert words == "brick to the left, moss to the right"
        page.page.go_back()
        page.until(SHOWN, 120)
        page.page.drag_and_drop(".card >> nth=0", ".card >> nth=1")
        page.page.wait_for_url("**/m/1+0/**")
        page.loaded()
        assert page.page.is_checked("input[name=left][value=second]")
        assert page.page.inner_text("#name") == "cloth"
        page.page.click("#home")
        page.page.wait_for_url(address.url)
        page.until(SHOWN, 120)
        page.complaints.clear()
