"""The page in a real browser: what it draws is what Python draws, and it talks to nobody else."""

import io
import os
import time
from dataclasses import replace
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
import torch
from example.exemplars import an_example
from materials import a_material
from PIL import Image
from shown import (
    HEIGHT,
    LAMP,
    STEP,
    WIDTH,
    around,
    expected,
    inner,
    picture,
    room_light,
)  # fmt: skip

from matcap.brdf.cook_torrance import MIN_ROUGHNESS
from matcap.example.example import Example
from matcap.files.color import srgb_decode
from matcap.relight.render import encode
from matcap.relight.scene import Film
from matcap.space.between import blend
from matcap.view.document import sealed_page
from matcap.view.subject import EncodedPicture, Maps, Materials

pytestmark = pytest.mark.programs
PLANES = [
    pytest.param(512, 512, WIDTH, 0.0, id="texel for pixel, across block borders"),
    pytest.param(2**40 - 700, -700, WIDTH, 1.0, id="far away"),
    pytest.param(512, 0, 2.5 * WIDTH, -0.5, id="filtered"),
    pytest.param(100, 300, WIDTH / 6, 0.0, id="magnified"),
]


@pytest.fixture(scope="module")
def address(subject, served):
    with served(subject) as address:
        yield address


@pytest.fixture(scope="module")
def page(address, shared_tab):
    """One page for all that only look at pictures."""
    return shared_tab(address.url)


@pytest.fixture
def own(tab, address):
    """A page of one's own, all of it there."""
    page = tab(address.url)
    page.loaded()
    return page


@pytest.mark.parametrize(("x", "y", "span", "exposure"), PLANES)
def test_the_plane_equals_that_of_relight(page, material, x, y, span, exposure):
    shown = picture(page, shape="plane", x=x, y=y, span=span, lamp=LAMP, exposure=exposure)
    wanted, _ = expected(around(material, x, y), "plane", span, exposure)
    assert np.abs(shown - wanted).max() <= 2 * STEP


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_round_surfaces_equal_those_of_relight(page, material, shape):
    shown = picture(page, shape=shape, x=256, y=256, span=WIDTH, lamp=LAMP)
    wanted, seen = expected(around(material, 256, 256), shape, WIDTH)
    assert seen.mean() > 0.2 and np.abs(shown - wanted)[inner(seen)].max() <= 2 * STEP


@pytest.mark.parametrize(("room_name", "mean", "most"), [("studio", 2, 8), ("dusk", 3, 16)])
def test_environments_equal_those_of_relight(page, material, tmp_path, room_name, mean, most):
    """Two ways to integrate over surroundings: 48 directions of a lobe, against 144."""
    # The pointer where it leaves the room as it is.
    shown = picture(
        page, shape="sphere", x=256, y=256, span=WIDTH, light=room_name, lamp=[-0.35, 0.3, 1]
    )
    lights = room_light(page, room_name, tmp_path / "room.exr")
    wanted, seen = expected(around(material, 256, 256), "sphere", WIDTH, lights=lights)
    off = np.abs(shown - wanted)[inner(seen, 4)]
    assert off.mean() <= mean * STEP and np.quantile(off, 0.99) <= most * STEP


@pytest.mark.parametrize("map_name", ["diffuse", "specular", "roughness", "height", "normal"])
def test_each_map_is_shown_alone(page, material, map_name):
    shown = picture(page, map=map_name, x=256, y=256, span=WIDTH)
    maps = material.maps(WIDTH + 2, HEIGHT + 2, x=255 - WIDTH // 2, y=255 - HEIGHT // 2)
    values = getattr(maps, map_name)[:, 1:-1, 1:-1].movedim(0, -1).numpy()
    if map_name == "diffuse":
        values = encode(values, Film())
    elif map_name == "normal":
        values = 0.5 + 0.5 * values
    else:
        values = np.maximum(values, MIN_ROUGHNESS) if map_name == "roughness" else values
        low, high = page.ask("matcap.view.range()")
        assert low <= values.min() < values.max() <= high
        values = (values - low) / (high - low)
    assert np.abs(shown - values).max() <= 1.01 * STEP


def test_another_seed_and_a_blend_are_other_texels(page, material, subject):
    shown = picture(page, map="diffuse", x=256, y=256, span=WIDTH, seed=5)
    maps = around(material, 256, 256, seed=5)
    assert np.abs(shown - expected_diffuse(maps)).max() <= 1.01 * STEP
    between = picture(page, map="diffuse", x=256, y=256, span=WIDTH, seed=5, share=0.5)
    maps = around(blend(subject.first, subject.second, 0.5), 256, 256, seed=5)
    assert np.abs(between - expected_diffuse(maps)).max() <= 1.01 * STEP


def expected_diffuse(maps):
    left, top = 512 - WIDTH // 2, 512 - HEIGHT // 2
    values = maps.diffuse[:, top : top + HEIGHT, left : left + WIDTH].movedim(0, -1).numpy()
    return encode(values, Film())


def test_nothing_is_fetched_from_elsewhere(own, address):
    assert {urlsplit(url).netloc for url in own.shown()} == {f"127.0.0.1:{address.port}"}
    assert all(urlsplit(url).path.startswith(f"/{address.token}/") for url in own.shown())


def test_first_picture_within_two_seconds(tab, subject, served):
    if os.getloadavg()[0] > (os.cpu_count() or 1):
        pytest.skip("the machine is busy: the clock would measure its other work")
    with served(subject) as address:
        page = tab(address.url)
        assert page.until("!!window.matcap && matcap.view.pages.held.size > 0") < 2.0
        page.loaded()  # what is still asked for, before nobody answers any more


class Slow(Maps):
    """A bright map set whose pages take their time."""

    seconds = 0.15

    def moments(self, level, area, **which):
        time.sleep(self.seconds)
        return super().moments(level, area, **which)


def bright(material):
    maps = material.maps(200, 150)
    return Slow(replace(maps, diffuse=0.5 + 0.5 * maps.diffuse), "bright")


# Every frame's darkest code while the view moves, a step a frame.
FILM = """async (steps) => {
  const { view } = matcap, { gl, canvas } = view, frames = [];
  const frame = () => new Promise(requestAnimationFrame);
  for (const step of steps) {
    matcap.set(step);
    await frame();
    view.draw();
    const codes = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
    let least = 255;
    for (let i = 0; i < codes.length; i++) if (codes[i] < least) least = codes[i];
    frames.push(least);
  }
  return frames;
}"""


def test_nothing_is_ever_black_while_one_moves_and_zooms(tab, served, material):
    with served(bright(material)) as address:
        page = tab(address.url)
        page.until("!!window.matcap")
        page.ask("() => Object.assign(matcap.view.canvas, {width: 160, height: 120})")
        way = [{"map": "diffuse", "shape": "plane"}]
        way += [{"x": 2000 + 200 * i} for i in range(25)]
        way += [{"span": 700 * 1.5**i} for i in range(25)]
        way += [{"x": 1e7, "y": -1e7}, {}, {}]
        way += [{"span": 1e7 / 2**i} for i in range(21)]
        way += [{"shape": "sphere"}, {"shape": "plane", "x": 1e9}, {}, {}]
        least = page.ask(FILM, way)
        page.loaded()
    # Linear 0.5 is code 188. The corners around a sphere are its ground, not texels.
    shown = [code for code, step in zip(least, way, strict=True) if step.get("shape") != "sphere"]
    assert min(shown) >= 186


def test_a_coarse_form_comes_first_then_the_nearest(tab, served, material):
    with served(bright(material)) as address:
        page = tab(address.url)
        page.loaded()
        asked = [parse_qs(urlsplit(url).query) for url in page.shown() if "/page?" in url]
        wanted = page.ask("matcap.view.wanted()")
    order = [tuple(int(one[key][0]) for key in ("level", "column", "row")) for one in asked]
    assert order == [(one["level"], one["column"], one["row"]) for one in wanted["pages"]]
    assert order[0][0] == wanted["best"] + 3
    away = [one["far"] for one in wanted["pages"] if one["level"] == wanted["best"]]
    assert away == sorted(away) and len(away) >= 4


def test_what_leaves_the_view_is_no_longer_asked_for(tab, served, material, monkeypatch):
    monkeypatch.setattr(Slow, "seconds", 3.0)
    with served(bright(material)) as address:
        page = tab(address.url)
        page.until("!!window.matcap && matcap.view.loading.size > 0")
        left = page.ask("""async () => {
          const before = [...matcap.view.loading.values()];
          matcap.set({x: 1e8});
          while (matcap.view.pending) await new Promise(requestAnimationFrame);
          return before.map(({stop}) => stop.signal.aborted);
        }""")
        monkeypatch.undo()
        page.loaded()
    assert left and all(left)


def test_zooming_has_no_end_but_single_texels_and_a_thousand_million(page, material):
    shown = picture(page, map="diffuse", x=256, y=256, span=2**30)
    mean = encode(material.maps(512, 512).diffuse.mean(dim=(1, 2)).numpy(), Film())
    assert np.abs(shown - mean).max() <= 6 * STEP
    texels = picture(page, map="diffuse", x=100.5, y=300.5, span=4)
    here = encode(material.maps(1, 1, x=100, y=300).diffuse[:, 0, 0].numpy(), Film())
    assert np.abs(texels[HEIGHT // 2, WIDTH // 2] - here).max() <= 2 * STEP


def test_keys_pointer_and_wheel(own):
    before = own.ask("matcap.view.state")
    own.page.focus("#canvas")
    for key in ("ArrowRight", "Shift+ArrowUp", "+", "]", "n", "s", "3", "l"):
        own.page.keyboard.press(key)
    after = own.ask("matcap.view.state")
    assert after["x"] == pytest.approx(before["x"] + before["span"] / 20)
    assert after["lamp"][1] == pytest.approx(before["lamp"][1] + 0.1)
    assert after["span"] == pytest.approx(before["span"] * 0.8)
    assert (after["exposure"], after["seed"]) == (0.25, before["seed"] + 1)
    assert (after["shape"], after["map"], after["light"]) == ("sphere", "specular", "studio")
    own.page.keyboard.press("Home")
    own.page.mouse.move(130, 250)
    assert own.ask("matcap.view.state.lamp[0]") < -0.3
    own.page.mouse.down()
    own.page.mouse.move(230, 250, steps=3)
    own.page.mouse.up()
    assert own.ask("matcap.view.state.x") < before["x"] - 50
    own.page.mouse.wheel(0, -400)
    own.until(f"matcap.view.state.span < {before['span'] * 0.6}")
    own.loaded()
    assert "texels across" in own.page.get_attribute("#canvas", "aria-label")


def test_two_fingers_zoom_and_move(tab, address):
    page = tab(address.url, has_touch=True)
    page.loaded()
    before = page.ask("matcap.view.state")
    fingers = page.page.context.new_cdp_session(page.page)

    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    width, height = page.ask("[matcap.view.canvas.clientWidth, matcap.view.canvas.clientHeight]")
    x, y = width / 2 + 60, height / 2
    touch("touchStart", (x - 40, y), (x + 40, y))
    for apart in (50, 60, 70, 80):
        touch("touchMove", (x - apart, y), (x + apart, y))
    page.until(f"Math.abs(matcap.view.state.span - {before['span'] / 2}) < 1")
    pinched = page.ask("matcap.view.state")
    # What lies between the fingers stays there.
    scale = before["span"] / max(width, height)
    assert pinched["x"] == pytest.approx(before["x"] + 60 * scale / 2, abs=2)
    assert pinched["y"] == pytest.approx(before["y"], abs=2)
    touch("touchMove", (x - 50, y + 30), (x + 110, y + 30))
    # A move of two fingers is two pointer events, and between these the distance is another.
    page.until(
        f"matcap.view.state.x < {pinched['x'] - 10 * scale}"
        f" && Math.abs(matcap.view.state.span - {before['span'] / 2}) < 1"
    )
    assert page.ask("matcap.view.state.y") == pytest.approx(pinched["y"] - 15 * scale, abs=2)
    touch("touchEnd")
    assert page.ask("matcap.view.state.lamp") == before["lamp"]
    # One finger is the light.
    touch("touchStart", (x, y))
    touch("touchMove", (x + 30, y - 20))
    touch("touchEnd")
    page.until(f"matcap.view.state.lamp[0] > {60 / width}")
    assert page.ask("document.getElementById('hint').className") == "gone"
    page.loaded()


def test_full_screen_comes_and_goes(own):
    own.page.click("#large")
    own.until("document.fullscreenElement === document.getElementById('stage')")
    own.until("matcap.view.canvas.clientWidth === innerWidth")
    own.loaded()
    own.page.keyboard.press("b")
    own.until("!document.fullscreenElement")
    own.until("matcap.view.canvas.clientWidth < innerWidth")
    own.loaded()


def test_no_mode_logs_an_error(tab, served):
    """The tab itself objects to whatever the console says."""
    material, result = photographed()
    with served(Materials(material, a_material(seed=4)), result) as address:
        page = tab(address.url)
        page.loaded()
        page.ask("size => Object.assign(matcap.view.canvas, size)", {"width": 64, "height": 48})
        faults = page.ask("""() => {
          const { view } = matcap, of = (name) => [...document.getElementsByName(name)].map(
            ({ value }) => value);
          const draw = (state) => {
            matcap.set({ ...view.initial(), ...state });
            view.draw(2);
            return view.gl.getError() ? [state] : [];
          };
          return of("map").flatMap((map) => of("light").flatMap((light) => [
            ...of("shape").flatMap((shape) => draw({ map, light, shape })),
            ...of("left").flatMap((left) => (map === "lit" ? draw({ light, left }) : [])),
          ]));
        }""")
        assert faults == []
        page.loaded()


def test_every_control_has_a_name(page):
    nameless = page.ask(
        """() => [...document.querySelectorAll(
            "input:not([type=hidden]), select, button, canvas, img")].filter((one) =>
          !(one.labels && one.labels.length) && !one.textContent.trim()
          && !one.getAttribute("aria-label") && !one.alt && !one.hidden && !one.closest("[hidden]")
        ).map((one) => one.outerHTML)"""
    )
    assert nameless == []


def test_saved_picture_is_what_is_shown(own):
    with own.page.expect_download() as download:
        own.page.click("#save")
    saved = download.value
    assert saved.suggested_filename == "test_plane_lit_seed0.png"
    size = own.ask("[matcap.view.canvas.width, matcap.view.canvas.height]")
    with Image.open(saved.path()) as stored:
        assert stored.size == tuple(size)


def test_without_webgl2_the_page_says_so(tab, address):
    page = tab("about:blank")
    page.page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.page.goto(address.url)
    assert "WebGL2" in page.page.inner_text("#trouble")


def test_a_lost_server_is_reported(tab, served, subject):
    with served(subject) as address:
        page = tab(address.url)
        page.loaded()
    page.ask("matcap.set({x: 1e6})")
    page.until("!document.getElementById('gone').hidden")
    assert "Start matcap view again" in " ".join(page.page.inner_text("#gone").split())
    page.complaints.clear()  # the browser's own words about the refused connection


def test_an_invalid_seed_is_said(own):
    for wrong in ("1.5", "many", "", "99999999999999999999"):
        own.page.fill("#seed", wrong)
        own.page.press("#seed", "Enter")
        own.page.locator("#seed").blur()
        assert "whole number" in own.page.inner_text("#seed-trouble"), wrong
    assert own.ask("matcap.view.state.seed") == 0
    own.page.fill("#seed", "-12")
    own.page.locator("#seed").blur()
    assert own.ask("matcap.view.state.seed") == -12
    assert not own.page.is_visible("#seed-trouble")
    own.loaded()


def test_the_hint_goes_with_the_first_drag_and_keys_fit_their_panel(own):
    assert "drag to wander" in own.page.inner_text("#hint")
    own.page.mouse.move(200, 200)
    own.page.mouse.down()
    own.page.mouse.move(240, 210, steps=2)
    own.page.mouse.up()
    assert own.ask("document.getElementById('hint').className") == "gone"
    own.page.keyboard.press("?")
    box = own.page.locator("#keys-dialog").bounding_box()
    assert box["y"] >= 0 and box["y"] + box["height"] <= 500
    assert own.ask("(d => d.scrollHeight <= d.clientHeight + 1)(document.querySelector('dialog'))")
    own.page.keyboard.press("Escape")
    assert not own.page.is_visible("#keys-dialog")
    own.loaded()


def photographed():
    """A material whose photograph is known, and that."""
    return a_material(example=an_example()), EncodedPicture(jpeg(), "image/jpeg")


def test_the_photograph_lies_beside_the_endless_field(tab, served):
    """At its own scale, as bright as it is, and clipped at the wipe."""
    material, result = photographed()
    wide, tall = material.part(Example).exemplar.size
    with served(Materials(material), result) as address:
        page = tab(address.url)
        page.loaded()
        assert not page.page.is_visible("#wipe")
        page.page.click("#left-choice label:has(input[value=photo])")
        assert page.ask("matcap.view.state.left") == "photo"
        home = page.ask("matcap.view.initial()")
        middle = {"span": WIDTH, "x": home["x"], "y": home["y"], "left": "photo"}
        both = picture(page, wipe=0.5, map="diffuse", **middle)
        brighter = picture(page, wipe=0.5, exposure=1, **middle)
        words = page.page.get_attribute("#wipe", "aria-valuetext")
        assert words == "photograph to the left, endless to the right"
        page.page.focus("#wipe")
        page.page.keyboard.press("ArrowLeft")
        assert page.ask("matcap.view.state.wipe") == pytest.approx(0.45)
        box = page.page.locator("#wipe").bounding_box()
        page.page.mouse.move(box["x"] + box["width"] / 2, 100)
        page.page.mouse.down()
        page.page.mouse.move(100, 100, steps=3)
        page.page.mouse.up()
        assert page.ask("matcap.view.state.wipe") < 0.25
        page.loaded()
    field = material.maps(WIDTH // 2, HEIGHT, x=home["x"], y=home["y"] - HEIGHT // 2)
    wanted = encode(field.diffuse.movedim(0, -1).numpy(), Film())
    assert np.abs(both[:, WIDTH // 2 :] - wanted).max() <= 2 * STEP
    shown = (
        slice((HEIGHT - tall) // 2, (HEIGHT + tall) // 2), slice((WIDTH - wide) // 2, WIDTH // 2),
    )  # fmt: skip
    assert np.abs(both[shown] - 90 / 255).max() <= 2 * STEP
    doubled = encode(srgb_decode(np.array(90 / 255)) * np.ones(3), Film(exposure=1.0))
    assert np.abs(brighter[shown] - doubled).max() <= 2 * STEP
    beside = both.copy()
    beside[shown] = beside[:, WIDTH // 2 :] = both[0, 0]
    assert np.ptp(beside) < 0.2  # the page's ground


def test_the_wipe_between_two_materials(tab, address, subject):
    """By keyboard and by finger."""
    page = tab(address.url, has_touch=True)
    page.loaded()
    page.page.focus("input[name=left][value=none]")
    page.page.keyboard.press("ArrowRight")
    assert page.ask("matcap.view.state.left") == "second"
    assert page.page.is_visible("#wipe")
    assert page.page.inner_text("#wipe-left") == "other"
    assert page.page.inner_text("#wipe-right") == "test"
    place = {"x": 512, "y": 512, "span": WIDTH, "map": "diffuse", "seed": 2}
    shown = picture(page, left="second", wipe=0.5, **place)
    half = WIDTH // 2
    for material, side in ((subject.second, slice(0, half)), (subject.first, slice(half, None))):
        maps = material.maps(WIDTH, HEIGHT, seed=2, x=512 - half, y=512 - HEIGHT // 2)
        wanted = encode(maps.diffuse.movedim(0, -1).numpy(), Film())
        assert np.abs(shown - wanted)[:, side].max() <= 2 * STEP
    blended = picture(page, left="second", wipe=0.5, share=0.5, **place)
    assert np.array_equal(blended[:, :half], shown[:, :half])  # only the right side walks
    assert np.abs(blended - shown)[:, half:].max() > 0.1
    assert page.page.inner_text("#wipe-right") == "blend"
    box = page.page.locator("#wipe").bounding_box()
    finger = page.page.context.new_cdp_session(page.page)
    for kind, x in (
        ("touchStart", box["x"] + box["width"] / 2),
        ("touchMove", 90),
        ("touchEnd", None),
    ):
        points = [] if x is None else [{"x": x, "y": 100}]
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    page.until("matcap.view.state.wipe < 0.25")


def test_the_turntable_moves_the_lamp(own):
    lamp = own.ask("matcap.view.state.lamp")
    own.page.click("#turn")
    own.until(f"Math.abs(matcap.view.state.lamp[0] - {lamp[0]}) > 0.01")
    own.page.click("#turn")


@pytest.mark.parametrize("size", [{"width": 1280, "height": 800}, {"width": 390, "height": 844}])
def test_page_fits_its_window(tab, address, size):
    page = tab(address.url, viewport=size)
    wide, tall = page.ask("[document.documentElement.scrollWidth, matcap.view.canvas.clientHeight]")
    assert wide <= size["width"] and tall >= 0.5 * size["height"]


def test_enclosed_page_draws_the_same_and_fetches_nothing(tab, material, subject, tmp_path):
    path = tmp_path / "page.html"
    result = EncodedPicture(jpeg(), "image/jpeg")
    path.write_text(sealed_page(subject, 256, result), encoding="utf-8")
    page = tab(path.as_uri())
    shown = picture(page, x=700, y=-900, span=WIDTH, lamp=LAMP)
    maps = material.maps(1024, 1024, x=700 - 512, y=-900 - 512, period=(256, 256))
    wanted, _ = expected(maps, "plane", WIDTH)
    assert np.abs(shown - wanted).max() <= 2 * STEP and page.shown() == []


def test_the_self_contained_page_shows_the_photograph(tab, tmp_path):
    material, result = photographed()
    path = tmp_path / "page.html"
    path.write_text(sealed_page(Materials(material), 256, result), encoding="utf-8")
    page = tab(path.as_uri())
    page.loaded()
    home = page.ask("matcap.view.initial()")
    shown = picture(page, left="photo", span=WIDTH, x=home["x"], y=home["y"])
    assert page.shown() == []
    assert np.abs(shown[HEIGHT // 2, WIDTH // 2 - 9] - 90 / 255).max() <= 2 * STEP


def test_map_set_repeats(tab, served, material):
    with served(Maps(material.maps(200, 150), "bricks")) as address:
        page = tab(address.url)
        shown = picture(page, map="diffuse", x=0, y=0, span=WIDTH)
        assert "200 × 150" in page.page.inner_text("#what")
        assert not page.page.is_visible("#seed-row")
    tile = encode(material.maps(200, 150).diffuse.movedim(0, -1).numpy(), Film())
    rows, columns = np.arange(-120, 120) % 150, np.arange(-160, 160) % 200
    assert np.abs(shown - tile[rows][:, columns]).max() <= 1.01 * STEP


def jpeg():
    stored = io.BytesIO()
    Image.fromarray(torch.full((6, 8, 3), 90, dtype=torch.uint8).numpy()).save(stored, "JPEG")
    return stored.getvalue()
