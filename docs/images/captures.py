"""The gallery: simulated photographs of sixteen kinds of material, and what captures make of them.

python docs/images/captures.py [NAME...]     all of them take a quarter of an hour

From the left: the photograph; the true material and the captured one under a light from the left,
which no photograph showed; the captured one as a sphere in the scene `studio`.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from matcap.api import relight
from matcap.brdf.maps import MapSet
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.files.color import srgb_picture
from matcap.flash.geometry import FlashSetup
from matcap.relight.render import encode
from matcap.relight.scene import Film, PointLight, Scene, Surface, exposing_intensity
from matcap.relight.scenefile import SCENES
from matcap_lab.simulate.files import write_dng
from matcap_lab.simulate.kinds import kind_of
from matcap_lab.simulate.photograph import PhoneCamera, as_photo, take
from matcap_lab.simulate.specimen import EXAMPLES, Specimen

HERE = Path(__file__).parent / "gallery"
# Of each kind the first draw that shows it plainly, chosen before it was captured.
KINDS = {
    "knit": 2, "basket": 3, "felt": 2, "planks": 1, "gravel": 5, "terrazzo": 5, "crackle": 4,
    "bond": 1, "hammered": 2, "worn": 5,
}  # fmt: skip
SETUP = FlashSetup(offset=(0.08, 0.05, 0.0), tilt=(0.015, -0.01))
SIDE = 224  # pixels of a panel
_DETAIL = 1024
_TEXELS = 512  # a side of the planes
# Cast shadows of relief this fine hardly show on a sphere, and take most of the time.
_QUICK = "auto,-environment,-visibility,-interreflection,-shadows,-parallax"
_GROUND = np.float32(0.1)  # grey behind spheres, in code values

Picture = NDArray[np.float32]


def main(names: list[str]) -> None:
    """Make the pictures of some materials, or of all."""
    HERE.mkdir(exist_ok=True)
    known = {**EXAMPLES} | {
        kind: Specimen(kind, kind_of(kind, number).realise, 0) for kind, number in KINDS.items()
    }
    for name in names or known:
        path = HERE / f"{name}.jpg"
        codes = np.rint(row(known[name]) * 255.0).astype(np.uint8)
        Image.fromarray(codes).save(path, "JPEG", quality=82)
        print(path, path.stat().st_size // 1024, "KB", flush=True)


def row(specimen: Specimen) -> Picture:
    """The four pictures of a material side by side, code values from 0 to 1."""
    shot = take(specimen.realise, PhoneCamera(), SETUP)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.dng"
        write_dng(path, shot, 1)
        material = capture_file(path, CaptureSettings(detail=_DETAIL)).material
    texel = 2.0 / _DETAIL
    true = specimen.pieces(specimen.seed + 1)(_TEXELS, _TEXELS, texel).map(lambda m: m.float())
    captured = material.maps(_TEXELS, _TEXELS)
    # Flash and albedo share a factor that no photograph tells: the truth's own is taken.
    gain = material.setup.intensity[1] / shot.setup.intensity[1]
    captured = replace(captured, diffuse=(captured.diffuse * gain).clamp(0.0, 1.0))
    photo = np.asarray(as_photo(shot, 1, "photo").pixels, np.float32)
    return np.concatenate([seen(photo), plane(true), plane(captured), sphere(captured)], axis=1)


def seen(linear: Picture) -> Picture:
    """The middle of a photograph (H, W, 3)."""
    rows, columns = linear.shape[:2]
    start = (columns - rows) // 2
    square = cv2.resize(linear[:, start : start + rows], (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.asarray(srgb_picture(square.clip(0.0, 1.0)), np.float32)


def plane(maps: MapSet) -> Picture:
    """Half of a photograph's width under a light from the left."""
    place = (-1.2, 0.8, 2.0)
    light = PointLight(place, (0.9 * exposing_intensity(place),) * 3)
    scene = Scene(film=Film(SIDE, SIDE), surface=Surface(size=1.0), lights=(light,))
    return np.asarray(encode(relight(maps, scene), Film()), np.float32)


def sphere(maps: MapSet) -> Picture:
    """A sphere in the studio, twice as fine and then shrunk, which smooths its outline."""
    studio = SCENES["studio"]
    assert studio.camera is not None
    film = Film(2 * SIDE, 2 * SIDE, exposure=1.5)
    studio = replace(studio, film=film, camera=replace(studio.camera, fov=25.0))
    radiance = relight(maps, studio, effects=_QUICK)
    ball = np.where(radiance.max(axis=2, keepdims=True) > 0.0, encode(radiance, film), _GROUND)
    return np.asarray(ball.reshape(SIDE, 2, SIDE, 2, 3).mean(axis=(1, 3)), np.float32)


if __name__ == "__main__":
    main(sys.argv[1:])
