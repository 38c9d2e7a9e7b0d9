"""How like relight the page draws metals: python tests/view/compare_metals.py [folder].

Draws each of four_metals.py in headless Chromium (software WebGL) and by relight, under a light
from high up, under a grazing one and in a room, on a plane and a sphere, and prints the largest,
the 99th percentile's and the mean difference of their pixels, of 255. A folder is given what both
drew, side by side.
"""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from conftest import FLAGS, Tab, serving
from four_metals import METALS, metal, repeated
from PIL import Image
from playwright.sync_api import sync_playwright
from shown import WIDTH, expected, inner, picture, room_light

from matcap.view.subject import Maps

# Lamps, in units of half the picture's long side or of the radius; stops of exposure.
LIGHTS = {"high": ((-0.25, 0.2, 1.0), 0.0), "grazing": ((-0.9, 0.3, 0.15), 3.0)}
SHAPES = {"plane": WIDTH, "sphere": 2 * WIDTH}


def where(shape, span):
    """The state that shows the maps' left top texel in the middle."""
    return {"shape": shape, "span": span, "x": 0, "y": 0}


def tell(what, shown, wanted, seen):
    """Print how far two pictures lie apart where there is a surface."""
    off = np.abs(shown - wanted)[seen] * 255
    print(f"{what}: {off.max():.2f} {np.quantile(off, 0.99):.2f} {off.mean():.3f}", flush=True)


def main(folder=None):
    """Print the figures."""
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in METALS:
            maps, rows = metal(name), []
            with serving(Maps(maps, name)) as address:
                tab = Tab(browser, address.url)
                for shape, span in SHAPES.items():
                    for light, (lamp, exposure) in LIGHTS.items():
                        shown = picture(tab, **where(shape, span), lamp=lamp, exposure=exposure)
                        wanted, seen = expected(repeated(maps), shape, span, exposure, lamp=lamp)
                        tell(f"{name}, {shape}, {light}", shown, wanted, inner(seen))
                        rows.append(np.concatenate([shown, wanted], axis=1))
                # The pointer where it leaves the room as it is.
                shown = picture(tab, **where(shape, span), light="studio", lamp=[-0.35, 0.3, 1])
                with TemporaryDirectory() as place:
                    lights = room_light(tab, "studio", Path(place) / "room.exr")
                    wanted, seen = expected(repeated(maps), shape, span, lights=lights)
                tell(f"{name}, {shape}, studio", shown, wanted, inner(seen, 4))
                rows.append(np.concatenate([shown, wanted], axis=1))
                tab.page.close()
            if folder:
                sheet = np.rint(np.concatenate(rows) * 255).astype(np.uint8)
                Image.fromarray(sheet).save(Path(folder) / f"{name.replace(' ', '_')}.png")
        browser.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
