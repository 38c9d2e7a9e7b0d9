"""Camera poses of a set: the first sharp photograph with flash gives the frame."""

from __future__ import annotations

from collections.abc import Sequence

from matcap.capture.tilt import fitted as fitted_one
from matcap.flash.coarse import CoarseFit
from matcap.flash.registration.ambient import flash_first
from matcap.flash.registration.register import Registration, register
from matcap.photo.photo import Photo


def fitted(photos: Sequence[Photo]) -> CoarseFit:
    """The coarse fit of the first photograph with flash, under that where it is known."""
    return fitted_one(flash_first(photos)[0])


def placed(photos: Sequence[Photo], coarse: CoarseFit | None = None) -> Registration:
    """All cameras of a set.

    Args:
        photos: two or more, in any order; the first with flash gives the frame, or the next one
            where that is blurred.
        coarse: result of fitted(), if it is known.
    """
    photos = flash_first(photos)
    registration = register(photos, (coarse or fitted(photos)).setup)
    if registration.blurred and len(registration.views) > 2:
        photos = flash_first([*photos[1:], photos[0]])
        registration = register(photos, fitted(photos).setup)
    return registration
