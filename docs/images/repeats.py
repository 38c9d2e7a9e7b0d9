"""Sheet of 24: what capture makes of simulated photographs, endless and repeated.

python docs/images/repeats.py [FILE]     takes about four minutes of a core

Twelve rows of two: the photograph, a part of the field, the piece made to repeat, both of
1024 x 768 texels and lit from the left. Captured with the preset `instant`, none left out after
it was seen.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from matcap.brdf.maps import MapSet
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.files.color import srgb_picture
from matcap_lab.simulate.photograph import PhoneCamera, as_photo
from matcap_lab.simulate.specimen import EXAMPLES, Specimen, photograph, subjects

FILE = Path(__file__).parent / "repeats.jpg"
KINDS = (
    "planks:1", "bond:1", "herringbone", "knit:2", "cable", "ribs", "weave", "basket:3", "marble",
    "crackle:4", "plates", "gravel:5", "terrazzo:5", "asphalt", "brushed", "scales", "loops",
    "chipped",
)  # fmt: skip
PANEL = (256, 192)  # pixels
_AREA = (1024, 768)  # texels
_LIGHT = np.array([-0.55, 0.35, 0.76])

Picture = NDArray[np.uint8]


def main(file: Path = FILE) -> None:
    """Make the sheet."""
    rows = []
    for subject in subjects([*EXAMPLES, *KINDS]):
        rows.append(row(subject))
        print(subject.name, flush=True)
    half = len(rows) // 2
    sheet = np.hstack([np.vstack(rows[:half]), np.vstack(rows[half:])])
    Image.fromarray(sheet).save(file, "JPEG", quality=65)
    print(file, file.stat().st_size // 1024, "KB")


def row(subject: Specimen) -> Picture:
    """Photograph, field and piece repeated, side by side."""
    with tempfile.TemporaryDirectory() as folder:
        path, shot = photograph(subject, PhoneCamera(), Path(folder))
        material = capture_file(path, CaptureSettings(preset="instant")).material
    photo = srgb_picture(np.asarray(as_photo(shot, subject.seed, "photo").pixels, np.float32))
    repeated = material.repeating()
    times = [-(-side // own) for side, own in zip(_AREA, repeated.size, strict=True)]
    again = repeated.map(lambda plane: plane.repeat(1, times[1], times[0])).crop(0, 0, *_AREA)
    exposed = 0.35 / max(float(material.maps(256, 256).diffuse.mean()), 0.02)
    show = partial(lit, gain=exposed)
    return np.hstack([framed(photo), show(material.maps(*_AREA, seed=1)), show(again)])


def lit(maps: MapSet, gain: float, size: tuple[int, int] = PANEL) -> Picture:
    """Maps under a light from the left, their highlights too, from straight above."""
    normal = maps.normal.numpy()
    light = _LIGHT / np.linalg.norm(_LIGHT)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    onto, mirrored = (
        np.clip(np.tensordot(way, normal, 1), 0.0, 1.0).astype(np.float32) for way in (light, half)
    )
    alpha = np.square(np.square(maps.roughness[0].numpy().clip(0.05, 1.0)))
    lobe = alpha / (4.0 * np.pi * np.square(np.square(mirrored) * (alpha - 1.0) + 1.0))
    light_out = maps.diffuse.numpy() + maps.specular.numpy() * lobe
    picture = (gain * onto * light_out).transpose(1, 2, 0).clip(0.0, 1.0)
    return framed(srgb_picture(picture), size)


def framed(picture: NDArray[np.float32], size: tuple[int, int] = PANEL) -> Picture:
    """Code values of a panel (width, height), a dark line around it."""
    inner = (size[0] - 4, size[1] - 4)
    small = cv2.resize(picture.astype(np.float32), inner, interpolation=cv2.INTER_AREA)
    codes = np.rint(255.0 * small.clip(0.0, 1.0)).astype(np.uint8)
    return cv2.copyMakeBorder(codes, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(24, 24, 24))


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
