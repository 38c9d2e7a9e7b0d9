"""Photographs of arrays."""

from dataclasses import replace

from matcap.files.color import LINEAR
from matcap.files.stated_color import StatedColor
from matcap.photo.developed import Coded, decode
from matcap.photo.exif import Exif
from matcap.photo.load import _photo


def photo_from_array(pixels, *, long_side=None, fov=None, radiometric=False, name="array"):
    """Linear light (H, W, 3), 1 at the clip level, as if it had been read from a file."""
    coded = Coded(pixels, StatedColor(space=LINEAR))
    photo = _photo(decode(coded, long_side), Exif(), fov, name, name)
    return replace(photo, radiometric=radiometric)
