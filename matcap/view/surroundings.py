"""Environment maps uploaded from the page, in formats that browsers do not read.

An .exr is decoded here, by what `matcap relight` reads environments with; the page reads the others
(page/reading.js).
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

LARGEST_FILE = 2**29  # bytes: an .exr of 16384 x 8192 in half floats is not larger
_WIDEST = 2048  # texels: what is wider is averaged down, as relight does


def decoded(data: bytes) -> NDArray[np.float32]:
    """(H, W, 3) linear radiance of an EXR file's bytes, latitude by longitude.

    Raises:
        MatcapError: it is none, or damaged, or its values are no radiance.
    """
    import cv2

    from matcap.relight.environment_file import read_picture

    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "surroundings.exr"
        file.write_bytes(data)
        try:
            picture = read_picture(file)
        except MatcapError as error:
            # The temporary path of the file is kept out of the error.
            raise MatcapError(error.what, where="the picture", remedy=error.remedy) from error
    height, width = picture.shape[:2]
    if width > _WIDEST:
        size = (_WIDEST, max(2, round(height * _WIDEST / width)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
    return picture
