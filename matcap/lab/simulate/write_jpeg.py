"""A simulated shot as a phone's JPEG: sRGB, with EXIF."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from matcap.files.output import Output
from matcap.files.srgb import srgb_picture
from matcap.lab.simulate.photograph import Shot, expose
from matcap.lab.simulate.write_dng import exif_of
from matcap.photo.tone import ToneCurve

# x^1.3 / (x^1.3 + 0.8^1.3), scaled to 1 at 1.
PHONE = ToneCurve(1.3, 1.0 / (1.0 + 0.8**1.3))
_QUALITY = 95
_EXIF_IFD = 34665


def write_jpeg(path: Path, shot: Shot, seed: int, tone: ToneCurve | None = None) -> None:
    """Write a shot as a JPEG of quality 95 with the noise of a seed; see write_dng.

    The tone curve is only sRGB's encoding by default.

    Raises:
        MatcapError: the file cannot be written.
    """
    linear = expose(shot, seed).astype(np.float32)
    code = srgb_picture((tone or ToneCurve()).developed(linear))
    picture = Image.fromarray(np.round(code * 255.0).astype(np.uint8))
    exif = Image.Exif()
    exif.update({271: "matcap", 272: "simulated phone", 274: 1})
    exif.get_ifd(_EXIF_IFD).update(
        {
            number: IFDRational(value) if isinstance(value, Fraction) else value
            for number, value in exif_of(shot).items()
        }
    )
    with Output.file(path) as file:
        picture.save(file, format="JPEG", quality=_QUALITY, exif=exif)
