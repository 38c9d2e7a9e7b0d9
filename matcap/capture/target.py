"""Texture statistics of windows of photographs, the target of optimisation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matcap.capture.method import FEATURES, Method
from matcap.capture.settings import CaptureSettings
from matcap.capture.start import CaptureStart
from matcap.capture.tilt import fitted
from matcap.capture.vgg_weights import load_vgg19
from matcap.space.tuning.joint import join
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.windows import cut_windows
from matcap.statistics.compare import Features
from matcap.statistics.filterbank import FilterBank


def photograph_target(
    shot: CaptureStart, settings: CaptureSettings, method: Method, most: int | None = None
) -> tuple[PhotographTarget, list[dict[str, Any]]]:
    """Windows and statistics for the texture distance, and a JSON entry for each other photograph.

    Args:
        shot: the photograph, with others.
        settings: names the statistics.
        method: has the weights.
        most: largest number of windows, or None.
    """
    plane, coarse = shot.plane, shot.coarse
    bank = _features(settings)
    target = PhotographTarget(
        cut_windows(plane, bank, shot.window, most=most),
        coarse.setup,
        plane.encoding,
        bank,
        shot.waves,
        plane.texel_size,
        weights=method.weights,
        expected=coarse.logits(),
    )
    fits = [fitted(photo) for photo in shot.others]
    others = [
        (photo.linearised(fit.tone), fit) for photo, fit in zip(shot.others, fits, strict=True)
    ]
    return join(target, coarse, others, plane.size[0]) if others else (target, [])


def _features(settings: CaptureSettings) -> Features:
    """Features whose statistics are compared."""
    return _STATISTICS[settings.statistics.name](settings.statistics.weights)


def _vgg19(weights: Path | None) -> Features:
    assert weights is not None
    return load_vgg19(weights)


# Constructors for the keys of settings.STATISTICS.
_STATISTICS: Mapping[str, Callable[[Path | None], Features]] = {
    "filterbank": lambda _: FilterBank(FEATURES),
    "vgg19": _vgg19,
}
