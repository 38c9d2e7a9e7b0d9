"""The target of fits: windows of one photograph, or of several."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matcap.capture.detail import Rectified
from matcap.capture.method import Method
from matcap.capture.settings import CaptureSettings
from matcap.capture.tilt import fitted
from matcap.capture.vgg_weights import load_vgg19
from matcap.flash.coarse import CoarseFit
from matcap.flash.joint import join
from matcap.flash.likeness import PhotographTarget
from matcap.flash.plane import Plane
from matcap.flash.windows import cut_windows
from matcap.photo.photo import Photo
from matcap.statistics.compare import Features
from matcap.statistics.filterbank import FilterBank
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class CaptureStart:
    """A photograph as every way of capturing it begins.

    Attributes:
        photo: as it is.
        coarse: its coarse fit.
        rectified: the photograph on its plane, of a decoder on the texels it is read on.
        window: texels a side of what is compared.
        others: more photographs of the same sample.
    """

    photo: Photo
    coarse: CoarseFit
    rectified: Rectified
    window: int
    others: Sequence[Photo] = ()

    @property
    def plane(self) -> Plane:
        """The photograph on the texels it is read on."""
        return self.rectified.read

    @property
    def waves(self) -> tuple[Wave, ...]:
        """Of its regular order, cycles a texel of that."""
        return self.rectified.read_waves


def photograph_target(
    shot: CaptureStart, settings: CaptureSettings, method: Method, most: int | None = None
) -> tuple[PhotographTarget, list[dict[str, Any]]]:
    """Windows and statistics for the texture distance, and a JSON entry for each other photograph.

    Args:
        shot: the photograph.
        settings: which statistics.
        method: of which features.
        most: windows at most, or None.
    """
    plane, coarse = shot.plane, shot.coarse
    bank = _features(settings, method)
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


def _features(settings: CaptureSettings, method: Method) -> Features:
    """What textures are compared by."""
    return _STATISTICS[settings.statistics.name](method, settings.statistics.weights)


def _vgg19(_: Method, weights: Path | None) -> Features:
    assert weights is not None
    return load_vgg19(weights)


# By name, as choices.STATISTICS has them; what is made of a method and a file.
_STATISTICS: Mapping[str, Callable[[Method, Path | None], Features]] = {
    "filterbank": lambda method, _: FilterBank(method.features),
    "vgg19": _vgg19,
}
