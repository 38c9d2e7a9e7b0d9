"""Detection of photographs without flash, by their metadata or their light.

Radiance by a flash beside the lens falls off from its mirror point; that by ambient light does not.
Metadata take precedence; the falloff decides only where they are silent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matcap.photo.inspect import hot_spot
from matcap.photo.photo import Photo


@dataclass(frozen=True)
class AmbientSettings:
    """When a photograph counts as one without flash."""

    faint: float = 1.15
    """Its middle over its border, at most, where its file says nothing; trades ambient photographs
    that are taken for flash against flash photographs that are left out."""
    shown: float = 1.3
    """The same of a photograph whose flash surely shows, at least; without one there is nothing to
    tell by."""


def flash_first(photos: Sequence[Photo]) -> list[Photo]:
    """Photographs in their order, but for those without flash, which come last."""
    dark = without_flash(photos)
    lit = [photo for number, photo in enumerate(photos) if number not in dark]
    return lit + [photos[number] for number in dark]


def without_flash(
    photos: Sequence[Photo], settings: AmbientSettings = AmbientSettings()
) -> dict[int, str]:
    """Indices of photographs taken without flash, each with its reason (end of a sentence).

    Empty where no photograph seems to have flash: EXIF does not record external flashes and ring
    lights.

    Args:
        photos: of one piece.
        settings: see AmbientSettings.
    """
    falloff = [hot_spot(photo)[1] for photo in photos]
    lit = [
        photo.flash_fired is True or (photo.flash_fired is None and bright >= settings.shown)
        for photo, bright in zip(photos, falloff, strict=True)
    ]
    if not any(lit):
        return {}
    reasons = {}
    for number, (photo, bright) in enumerate(zip(photos, falloff, strict=True)):
        if photo.flash_fired is False:
            reasons[number] = "its file says that the flash did not fire"
        elif photo.flash_fired is None and bright < settings.faint:
            reasons[number] = (
                "no flash shows in it: its middle is hardly brighter than its border "
                f"({bright:.2f} times)"
            )
    return reasons
