"""Detection of photographs without flash, by their metadata or their light.

Radiance under a flash next to the lens falls off from its mirror point; under ambient light it does
not. Metadata take precedence; the falloff decides only without them.
"""

from __future__ import annotations

from collections.abc import Sequence

from matcap.photo.inspect import hot_spot
from matcap.photo.photo import Photo

# Limits of the falloff.

# Largest ratio of centre to border of a photograph without flash; larger values reject more
# flash photographs, smaller ones accept more ambient ones.
_FAINT = 1.15
_SHOWN = 1.3  # least ratio that proves a flash; without such a photograph none counts as ambient


def flash_first(photos: Sequence[Photo]) -> list[Photo]:
    """Move photographs without flash to the end, otherwise keeping the order."""
    dark = without_flash(photos)
    lit = [photo for number, photo in enumerate(photos) if number not in dark]
    return lit + [photos[number] for number in dark]


def without_flash(photos: Sequence[Photo]) -> dict[int, str]:
    """Indices of photographs taken without flash, each with its reason (end of a sentence).

    Empty if no photograph seems to have flash, as EXIF does not record external flashes and ring
    lights.

    Args:
        photos: of one sample.
    """
    falloff = [hot_spot(photo)[1] for photo in photos]
    lit = [
        photo.flash_fired is True or (photo.flash_fired is None and bright >= _SHOWN)
        for photo, bright in zip(photos, falloff, strict=True)
    ]
    if not any(lit):
        return {}
    reasons = {}
    for number, (photo, bright) in enumerate(zip(photos, falloff, strict=True)):
        if photo.flash_fired is False:
            reasons[number] = "the flash did not fire by its metadata"
        elif photo.flash_fired is None and bright < _FAINT:
            reasons[number] = (
                "it shows no flash: its middle is hardly brighter than its border "
                f"({bright:.2f} times)"
            )
    return reasons
