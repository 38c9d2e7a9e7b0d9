"""Captures of what goes wrong: each ends in finite maps within their ranges, or in one sentence.

Photographs that go wrong in every way we know of (photographs.py), captured by both generators, as
RAW and as developed pictures, upright and not; their exemplars rearranged, as they are and with
every variety; sets of photographs and parts of them likewise (wholes.py).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from arrays import photo_from_array
from numpy.typing import NDArray

from matcap.capture.exemplar.estimate import ExemplarEstimate
from matcap.capture.pipeline import capture_photo
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.field.plane import Rectangle
from matcap.photo.developed import light
from matcap.photo.photo import SHOULDER, WITH_GAIN_MAP, Development, ToneCurve
from matcap.space.tuned import TunedDecoder
from stable.edges.swept import Domain, Swept
from stable.photographs import FOV, HARD_PHOTOGRAPHS
from stable.wholes import HARD_SETS, PARTS, capture_bracket, capture_part, capture_set

_MAPS = ("diffuse", "specular", "roughness", "height", "normal")
_FIELD = 64  # texels a side of what is read by example
_VARIETIES = (None, 0.0, 1.0)  # its own, and the ends
# Texels across and down; a small photograph has too few windows for relief's strength, and the
# finest octaves of the last are not the network's, but transferred from the photograph.
_SMALL, _LARGE, _FINE = (128, 96), (384, 288), (1152, 864)
_SHARES = (0.70, 0.24, 0.06)  # of the draws by these sizes
_STEPS = 3
_PHONE = ToneCurve(1.4, SHOULDER)
_HEADROOM = 4.5  # light over white of a base with gain map, 2.2 stops


def capture_array(
    pixels: NDArray[np.float32],
    settings: CaptureSettings,
    name: str,
    *,
    developed: bool = False,
    headroom: float = 1.0,
) -> CaptureResult:
    """Capture a picture given as an array, as a RAW or with a tone curve.

    With headroom its light reaches above white, and a developed one is a base with gain map.

    Raises:
        MatcapError: it is refused.
    """
    light(Path(name), pixels, 1.0, ())  # refuses what readers of files refuse
    photo = photo_from_array(
        pixels, long_side=settings.detail, fov=FOV, radiometric=True, name=name
    )
    if developed:
        # Beyond the clip level in proportion, as ToneCurve.linear reads it: a file of floats.
        within, beyond = np.minimum(photo.pixels, 1.0), np.maximum(photo.pixels, 1.0)
        pixels = _PHONE.developed(within) * beyond
        curve = Development() if headroom == 1.0 else WITH_GAIN_MAP
        photo = replace(photo, radiometric=False, tone=None, pixels=pixels, development=curve)
    photo = replace(photo, pixels=photo.pixels * np.float32(headroom), headroom=headroom)
    return capture_photo(photo, settings)


def finite(result: CaptureResult) -> bool:
    """Whether maps, re-rendering, statistics and weights are free of NaN and infinity.

    Of the photographed piece too, where it was found.
    """
    material = result.material
    tensors = [getattr(result.maps, name) for name in _MAPS]
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        tensors += [moment for pair in tuned.moments for moment in pair]
        tensors += list(tuned.decoder.state_dict().values())
    numbers = [*material.setup.offset, *material.setup.tilt, *material.setup.intensity]
    if result.estimate is not None:
        tensors += _piece(result.estimate, result.settings.seed)
        numbers.append(result.estimate.error)
    return (
        all(bool(torch.isfinite(tensor).all()) for tensor in tensors)
        and bool(np.isfinite(result.rerendered).all())
        and all(math.isfinite(number) for number in numbers)
    )


def within_ranges(found: ExemplarEstimate, seed: int) -> bool:
    """Whether albedo, F0 and roughness of the piece and of a field made of it are in [0, 1]."""
    return all(
        bool((maps[:5] >= 0.0).all() and (maps[:5] <= 1.0).all())
        for maps in _piece(found, seed)[: 1 + len(_VARIETIES)]
    )


def _piece(found: ExemplarEstimate, seed: int) -> list[torch.Tensor]:
    """The piece's maps, small fields that rearrange them, and what the photograph told."""
    area = Rectangle(0, 0, _FIELD, _FIELD)
    fields = [found.example.varied(variety).maps(seed, area, None) for variety in _VARIETIES]
    values = found.relief_spectrum
    numbers = [] if values is None else [values.albedo, values.slope, values.deviation]
    return [torch.from_numpy(array) for array in (found.exemplar.stacked(), *fields, *numbers)]


def photographs(name: str) -> Domain:
    """A photograph of HARD_PHOTOGRAPHS, RAW or developed, upright or not, by either generator."""

    def captured(g: np.random.Generator) -> Swept:
        width, height = (_SMALL, _LARGE, _FINE)[int(g.choice(3, p=_SHARES))]
        seed, developed, turned = int(g.integers(1000)), g.random() < 0.4, g.random() < 0.25
        by, asked = "example", CaptureSettings(detail=width, seed=seed, generator="example")
        if width <= _LARGE[0] and g.random() < 0.3:
            prior = ("auto", "none")[int(g.integers(2))]
            by = f"decoder, prior {prior}"
            asked = replace(
                asked, preset="draft", steps=_STEPS, prior=prior, generator="decoder", aligned=True
            )
        pixels = HARD_PHOTOGRAPHS[name](width, height, seed)
        pixels = np.ascontiguousarray(np.rot90(pixels, -1)) if turned else pixels
        headroom = _HEADROOM if g.random() < 0.3 else 1.0
        result = capture_array(pixels, asked, name, developed=developed, headroom=headroom)
        where = f"seed {seed}, {by}, {width} across, white at {1.0 / headroom:.2g}"
        return _swept(result, where + ", developed" * developed + ", portrait" * turned)

    return captured


def sets(name: str) -> Domain:
    """A set of HARD_SETS."""
    return _whole(lambda w, h, asked: capture_set(HARD_SETS[name](w, h, asked.seed), asked, name))


def brackets(name: str) -> Domain:
    """A photograph of HARD_PHOTOGRAPHS merged with its darker exposures."""
    hard = HARD_PHOTOGRAPHS[name]
    return _whole(lambda w, h, asked: capture_bracket(hard(w, h, asked.seed), asked, name))


def parts(name: str) -> Domain:
    """A part of PARTS."""
    photograph = HARD_PHOTOGRAPHS["an ordinary one"]
    return _whole(
        lambda w, h, asked: capture_part(photograph(w, h, asked.seed), PARTS[name], asked, name)
    )


def _whole(capture: Callable[[int, int, CaptureSettings], CaptureResult]) -> Domain:
    """Large enough for keypoints and for relief's strength."""

    def captured(g: np.random.Generator) -> Swept:
        width, height = _LARGE
        seed = int(g.integers(1000))
        asked = CaptureSettings(detail=width, seed=seed, generator="example")
        return _swept(capture(width, height, asked), f"seed {seed}")

    return captured


def _swept(result: CaptureResult, where: str) -> Swept:
    assert result.estimate is not None
    sound = finite(result) and within_ranges(result.estimate, result.settings.seed)
    return Swept(1, int(not sound), 0, result.estimate.error, where)
