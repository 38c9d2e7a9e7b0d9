"""Camera poses of a set: the first sharp photograph with flash gives the frame."""

from __future__ import annotations

from collections.abc import Sequence

from matcap.flash.geometry import FlashSetup
from matcap.flash.registration.ambient import flash_first
from matcap.flash.registration.register import Registration, register
from matcap.photo.photo import Photo


def placed(photos: Sequence[Photo]) -> Registration:
    """All cameras of a set; where the first begins makes no difference (docs/notes/several.md).

    Args:
        photos: two or more, in any order; the first with flash gives the frame, or the next one
            where that is blurred.
    """
    photos = flash_first(photos)
    registration = register(photos, FlashSetup(fov=photos[0].fov))
    if registration.blurred and len(registration.views) > 2:
        photos = flash_first([*photos[1:], photos[0]])
        registration = register(photos, FlashSetup(fov=photos[0].fov))
    return registration
