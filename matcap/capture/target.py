"""What a material is compared with: windows of the photograph, or of several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matcap.capture.settings import CaptureSettings, Method
from matcap.flash.coarse import CoarseFit
from matcap.flash.joint import join
from matcap.flash.likeness import PhotographTarget
from matcap.flash.plane import Plane
from matcap.flash.windows import cut_windows
from matcap.photo.photo import Photo
from matcap.statistics.compare import Features
from matcap.statistics.filterbank import FilterBank
from matcap.statistics.lattice import Wave
from matcap.statistics.vgg import Vgg19


def photograph_target(
    plane: Plane,
    coarse: CoarseFit,
    waves: tuple[Wave, ...],
    settings: CaptureSettings,
    method: Method,
    window: int,
    others: Sequence[Photo] = (),
    most: int | None = None,
) -> tuple[PhotographTarget, list[dict[str, Any]]]:
    """What a material is compared with, and what was found of each other photograph.

    Args:
        plane: the photograph.
        coarse: its coarse fit.
        waves: of its regular order.
        settings: which statistics.
        method: of which features.
        window: texels a side of what is compared.
        others: more photographs of the same sample.
        most: windows at most, or None.
    """
    bank = _features(settings, method)
    target = PhotographTarget(
        cut_windows(plane, bank, window, most=most),
        coarse.setup,
        plane.encoding,
        bank,
        waves,
        plane.texel_size,
        expected=coarse.logits(),
    )
    return join(target, coarse, others, plane.size[0]) if others else (target, [])


def _features(settings: CaptureSettings, method: Method) -> Features:
    """What textures are compared by."""
    weights = settings.statistics.weights
    return FilterBank(method.features) if weights is None else Vgg19.load(weights)
