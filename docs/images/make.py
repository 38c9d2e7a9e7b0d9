"""Make the pictures of docs/ again: nothing in them comes from anywhere but matcap itself.

python docs/images/make.py shooting          photographs simulated well and badly
python docs/images/make.py page MATERIAL...  screenshots of matcap view (needs the extras view and
                                             browser, and Chromium); a second material is blended
"""

from __future__ import annotations

import argparse
import io
import math
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from matcap.api import relight
from matcap.files.color import srgb_picture
from matcap.flash.geometry import FlashSetup
from matcap.relight.scene import EnvironmentLight, Film, Scene, Surface
from matcap_lab.simulate.photograph import PhoneCamera, expose, take
from matcap_lab.simulate.specimen import EXAMPLES

HERE = Path(__file__).parent
_SMALL = PhoneCamera(width=640, height=480, supersampling=1)


def main() -> None:
    """Parse the command line and make what it asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("shooting", "page"))
    parser.add_argument("materials", nargs="*", type=Path)
    chosen = parser.parse_args()
    if chosen.what == "page":
        page(chosen.materials)
    else:
        shooting()


def shooting() -> None:
    """The same piece of leather, photographed five times."""
    leather = EXAMPLES["leather"]
    level = FlashSetup(offset=(0.12, 0.05, 0.0), tilt=(math.radians(1.0), 0.0))
    tilted = replace(level, tilt=(math.radians(22.0), math.radians(-8.0)))
    aside = replace(level, offset=(1.6, 0.7, 0.0))
    burnt = replace(_SMALL, brightness=0.75, clipped=0.3)
    shots = {
        "good": take(leather.realise, _SMALL, level),
        "tilted": take(leather.realise, _SMALL, tilted),
        "clipped": take(leather.realise, burnt, level),
        "no-highlight": take(leather.realise, _SMALL, aside),
    }
    for name, shot in shots.items():
        save(srgb_picture(expose(shot, 1).astype(np.float32)), HERE / "shooting" / f"{name}.jpg")
    maps = leather.realise(640, 480, 2.0 / 640).map(lambda m: m.float())
    lights = (EnvironmentLight(radiance=(0.55, 0.6, 0.7)),)
    even = relight(maps, Scene(film=Film(640, 480), surface=Surface(size=None), lights=lights))
    save(srgb_picture(even), HERE / "shooting" / "no-flash.jpg")


def save(codes: NDArray[np.float32], path: Path) -> None:
    """Write code values from 0 to 1 as a small JPEG."""
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.rint(codes * 255.0).astype(np.uint8)).save(path, "JPEG", quality=82)
    print(path.relative_to(HERE.parent), path.stat().st_size // 1024, "KB")


# Name of a screenshot, the window's size, and what is done before it is taken.
SCREENSHOTS = {
    "plane": ((1280, 800), "matcap.set({lamp: [-0.3, 0.25, 0.8]})"),
    "sphere": ((1280, 800), "matcap.set({shape: 'sphere', span: 800, lamp: [-0.6, 0.5, 1.2]})"),
    "cylinder": ((1280, 800), "matcap.set({shape: 'cylinder', span: 800, lamp: [-0.6, 0.4, 1.2]})"),
    "room": ((1280, 800), "matcap.set({shape: 'sphere', span: 800, light: 'dusk', exposure: 0.5})"),
    "diffuse": ((1280, 800), "matcap.set({map: 'diffuse'})"),
    "specular": ((1280, 800), "matcap.set({map: 'specular'})"),
    "roughness": ((1280, 800), "matcap.set({map: 'roughness'})"),
    "height": ((1280, 800), "matcap.set({map: 'height'})"),
    "normal": ((1280, 800), "matcap.set({map: 'normal'})"),
    "photograph": ((1280, 800), "document.querySelector('input[value=photo]').click()"),
    "blend": ((1280, 800), "matcap.set({share: 0.5, lamp: [-0.3, 0.25, 0.8]})"),
    "afar": ((1280, 800), "matcap.set({span: 12000, lamp: [-0.3, 0.25, 0.8]})"),
    "phone": ((390, 844), "matcap.set({shape: 'sphere', span: 700, lamp: [-0.5, 0.5, 1.2]})"),
}


def page(paths: list[Path]) -> None:
    """A screenshot of every mode of the page."""
    import uvicorn
    from playwright.sync_api import sync_playwright

    from matcap.view.server import listen, make_app, new_address
    from matcap.view.subject import Pages, open_subject, reference_photograph

    subject = open_subject(*paths[:2])
    beside = reference_photograph(paths[0], subject.facts.name, None, subject.first)
    listening = listen(0)
    address = new_address(listening.getsockname()[1])
    app = make_app(Pages(subject), address, beside)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        for name, ((width, height), action) in SCREENSHOTS.items():
            tab = browser.new_page(viewport={"width": width, "height": height}, color_scheme="dark")
            tab.goto(address.url)
            while not tab.evaluate("!!window.matcap"):
                time.sleep(0.05)
            tab.evaluate(action)
            while not tab.evaluate("matcap.view.complete && !matcap.view.pending"):
                time.sleep(0.05)
            time.sleep(0.3)
            tab.evaluate("matcap.view.draw()")
            target = HERE / "view" / f"{name}.jpg"
            target.parent.mkdir(exist_ok=True)
            taken = Image.open(io.BytesIO(tab.screenshot(timeout=120_000))).convert("RGB")
            taken.save(target, "JPEG", quality=52, optimize=True, progressive=True)
            print(target.relative_to(HERE.parent), target.stat().st_size // 1024, "KB")
            tab.close()
        browser.close()
    server.should_exit = True
    thread.join()


if __name__ == "__main__":
    main()
