"""Decodes environment maps in OpenEXR that are uploaded from the page.

Other formats are decoded in the browser (page/reading.js).
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError

LARGEST_FILE = 2**29  # bytes; more than 16384 x 8192 half floats take
_WIDEST = 2048  # texels; wider maps are downsampled, as in relight


def decoded(data: bytes) -> NDArray[np.float32]:
    """(H, W, 3) linear radiance, equirectangular, of an EXR file's bytes.

    Raises:
        MatcapError: the data are not an EXR file, damaged, or have invalid values.
    """
    import cv2

    from matcap.relight.environment_file import read_picture

    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "surroundings.exr"
        file.write_bytes(data)
        try:
            picture = read_picture(file)
        except MatcapError as error:
            # Without the temporary path.
            raise MatcapError(error.what, where="the picture", remedy=error.remedy) from error
    height, width = picture.shape[:2]
    if width > _WIDEST:
        size = (_WIDEST, max(2, round(height * _WIDEST / width)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
    return picture
