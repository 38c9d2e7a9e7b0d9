"""Pictures that a page draws in Chromium: needs playwright and a Chromium, no screen.

What npm installs lies in `.node`: `npm install --prefix .node three`.
"""

import base64
import json
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

MODULES = Path(__file__).parents[2] / ".node" / "node_modules"
_PLACE = "http://page.test"
# Software WebGL, which needs no screen.
_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
_KINDS = {".js": "text/javascript", ".png": "image/png"}


def camera_of(maps) -> dict:
    """What a page must know of `matcap relight`'s camera: above the whole plane."""
    width, height = maps.size
    longest = max(width, height)
    # Libraries take the angle across the height.
    tall = 2.0 * np.degrees(np.arctan(np.tan(np.radians(22.5)) * height / longest))
    eye = longest * maps.texel_size / 2.0 / np.tan(np.radians(22.5))
    return {"size": [width, height], "eye": float(eye), "angle": float(tall)}


def drawn(script, about, page="", folder=Path()) -> np.ndarray:
    """(H, W, 3) of a script: a function of JSON text that gives floats, RGBA, the lowest row first.

    Args:
        script: JavaScript; may import from /modules/ and load from /export/.
        about: what it is told; its `size` is that of the picture.
        page: HTML that it runs in.
        folder: what is at /export/.
    """
    width, height = about["size"]
    with browsing() as browser:
        tab = browser.new_page()
        tab.route(f"{_PLACE}/**", lambda route: _serve(route, page, folder))
        tab.goto(f"{_PLACE}/")
        said = tab.evaluate(script, json.dumps(about))
        tab.close()
    found = np.frombuffer(base64.b64decode(said), dtype=np.float32).reshape(height, width, 4)
    return found[::-1, :, :3]


@contextmanager
def if_installed():
    """Skip the test where there is no playwright or Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    try:
        yield
    except api.Error as error:
        if "Executable" not in str(error):
            raise
        pytest.skip(f"no Chromium ({str(error).splitlines()[0]})")


@contextmanager
def browsing():
    """A Chromium: the one of who asked before, around this, or one of its own."""
    from playwright.sync_api import sync_playwright

    if _running:
        yield _running[0]
        return
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as play:
        _running.append(play.chromium.launch(executable_path=program, args=_FLAGS))
        try:
            yield _running[0]
        finally:
            _running.pop().close()


_running: list = []


def _serve(route, page, folder) -> None:
    path = route.request.url.removeprefix(_PLACE).split("?")[0]
    if path == "/":
        route.fulfill(body=page, content_type="text/html")
        return
    _, kind, inner = path.split("/", 2) if path.count("/") > 1 else ("", "", path)
    place = MODULES / inner if kind == "modules" else folder / Path(path).name
    if not place.is_file():
        route.fulfill(status=404)
        return
    content = _KINDS.get(place.suffix, "application/octet-stream")
    route.fulfill(body=place.read_bytes(), content_type=content)
