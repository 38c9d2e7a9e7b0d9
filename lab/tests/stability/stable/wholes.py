"""Sets of photographs that go wrong, and parts of photographs: the rest of the whole product.

Sets are views of one picture, for what is looked for is NaN and bugs, and not how right a piece is;
lights that move along are in tests/capture/registration.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import cv2
import numpy as np
from arrays import photo_from_array
from numpy.typing import NDArray

from matcap.capture.bracket import merge_bracket
from matcap.capture.pipeline import capture_photo
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.files.settings import Rectangle
from matcap.photo.developed import light
from matcap.photo.left_out import leave_out
from stable.photographs import FOV, HARD_PHOTOGRAPHS, Pixels, textured

Set = Callable[[int, int, int], list[Pixels]]
Mask = NDArray[np.uint8]


def views(
    width: int, height: int, seed: int, count: int = 3, of: str = "an ordinary one"
) -> list[Pixels]:
    """A picture, and how it looks moved by up to a fifth, turned and leaning a little."""
    first, rng = HARD_PHOTOGRAPHS[of](width, height, seed), np.random.default_rng(seed)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = [first]
    for _ in range(count - 1):
        moved = corners + rng.uniform(-0.2, 0.2, (1, 2)) * width
        moved = (moved + rng.uniform(-0.03, 0.03, (4, 2)) * width).astype(np.float32)
        warp = cv2.getPerspectiveTransform(corners, moved)
        warped = cv2.warpPerspective(
            first, warp, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        seen.append(np.clip(warped, 0.0, None).astype(np.float32))
    return seen


def _last(change: Callable[[Pixels, int], Pixels]) -> Set:
    """The last of three changed."""

    def made(width: int, height: int, seed: int) -> list[Pixels]:
        *others, last = views(width, height, seed)
        return [*others, np.ascontiguousarray(change(last, seed), dtype=np.float32)]

    return made


def _all(name: str) -> Set:
    """Three of a hard photograph."""
    return lambda width, height, seed: [HARD_PHOTOGRAPHS[name](width, height, seed)] * 3


def _nan(pixels: Pixels, _seed: int) -> Pixels:
    pixels = pixels.copy()
    pixels[0, 0] = math.nan
    return pixels


HARD_SETS: Mapping[str, Set] = MappingProxyType(
    {
        "an ordinary one": views,
        "two": partial(views, count=2),
        "six": partial(views, count=6),
        "the same one three times": _all("an ordinary one"),
        "grey": _all("grey"),
        "noise alone": _all("noise alone"),
        "stripes": _all("stripes"),
        "left half clipped": _all("left half clipped"),
        "mirror": _all("mirror"),
        "gold": _all("gold"),
        "half of it gold": _all("half of it gold"),
        "two reflectances, six": partial(views, count=6, of="half of it gold"),
        "one of another material": _last(
            lambda pixels, seed: textured(*pixels.shape[1::-1], seed + 1000, diffuse=0.1)
        ),
        "one black": _last(lambda pixels, _: 0.0 * pixels),
        "one white": _last(lambda pixels, _: 0.0 * pixels + 1.0),
        "one NaN": _last(_nan),
        "one a thousand times darker": _last(lambda pixels, _: 1e-3 * pixels),
        "one upside down": _last(lambda pixels, _: pixels[::-1, ::-1]),
        "one of half the size": _last(lambda pixels, _: pixels[::2, ::2]),
        "one blurred": _last(lambda pixels, _: cv2.GaussianBlur(pixels, (0, 0), 9.0)),
    }
)


# Photographs that are merged with exposures of a quarter and a sixteenth.
BRACKETED = ("an ordinary one", "left half clipped", "mirror", "half of it gold", "noise alone")


@dataclass(frozen=True)
class Part:
    """What of a photograph is the material."""

    crop: tuple[float, float, float, float] | None = None
    """(x, y, width, height) as shares of the sides, or None."""
    mask: Callable[[int, int], Mask] | None = None
    """(width, height) to a mask, or None."""


def _masked(
    inside: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]],
) -> Part:
    """White where it is inside, of x and y in [-1, 1]."""

    def mask(width: int, height: int) -> Mask:
        y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
        return np.where(inside(x, y), 255, 0).astype(np.uint8)

    return Part(mask=mask)


PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "the middle": Part((0.2, 0.2, 0.6, 0.6)),
        "a corner": Part((0.0, 0.0, 0.5, 0.5)),
        "a strip": Part((0.0, 0.0, 1.0, 0.1)),
        "beyond the border": Part((0.5, 0.5, 0.6, 0.6)),
        "all of it": _masked(lambda x, y: x * x < 2.0),
        "nothing": _masked(lambda x, y: x * x > 2.0),
        "a disc": _masked(lambda x, y: x * x + y * y < 0.5),
        "all but a disc": _masked(lambda x, y: x * x + y * y > 0.3),
        "two halves apart": _masked(lambda x, y: abs(x) > 0.2),
        "every other pixel": _masked(lambda x, y: np.indices(x.shape).sum(0) % 2 == 0),
        "specks": _masked(lambda x, y: np.sin(37.0 * x) * np.sin(29.0 * y) > 0.5),
        "a mask of another size": Part(mask=lambda width, height: np.full((9, 9), 255, np.uint8)),
    }
)


def capture_set(pictures: list[Pixels], settings: CaptureSettings, name: str) -> CaptureResult:
    """Capture photographs of one piece, given as arrays.

    Raises:
        MatcapError: they are refused.
    """
    for pixels in pictures:
        light(Path(name), pixels, 1.0)  # refuses what readers of files refuse
    first, *others = (
        photo_from_array(pixels, fov=FOV, radiometric=True, name=f"{name}, {number}")
        for number, pixels in enumerate(pictures)
    )
    return capture_photo(first, settings, others=others)


def capture_bracket(pixels: Pixels, settings: CaptureSettings, name: str) -> CaptureResult:
    """Capture three exposures from one place, of which only the darkest clips nowhere.

    Raises:
        MatcapError: they are refused.
    """
    exposures = (2.0, 0.5, 0.125)
    photos = (
        photo_from_array(np.minimum(k * pixels, 1.0), fov=FOV, radiometric=True, name=name)
        for k in exposures
    )
    merged = [replace(photo, exposure=k) for photo, k in zip(photos, exposures, strict=True)]
    return capture_photo(merge_bracket(merged), settings)


def capture_part(pixels: Pixels, part: Part, settings: CaptureSettings, name: str) -> CaptureResult:
    """Capture a part of a photograph.

    Raises:
        MatcapError: it is refused.
    """
    height, width = pixels.shape[:2]
    photo = photo_from_array(pixels, fov=FOV, radiometric=True, name=name)
    crop = None
    if part.crop is not None:
        x, y, w, h = part.crop
        crop = Rectangle(round(x * width), round(y * height), round(w * width), round(h * height))
    with TemporaryDirectory() as folder:
        mask = None if part.mask is None else Path(folder) / "mask.png"
        if part.mask is not None:
            cv2.imwrite(str(mask), part.mask(width, height))
        left = leave_out(photo, crop, mask)
    return capture_photo(left, settings)
