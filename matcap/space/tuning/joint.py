"""Joint target of several photographs: one decoder is tuned to the windows of all.

Every photograph keeps the tilt, flash offset and vignetting of its coarse fit. Its gain is
normalised to the first one's, so that albedo is the same. The first photograph gives latent vector,
encoding and lattice.

Assumes the same sample at about the same distance, so that texels have one size. No correspondence
of windows is needed, as texture statistics are compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from matcap.errors import MatcapError
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import read_plane
from matcap.photo.photo import Photo
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.windows import Windows, cut_windows
from matcap.statistics.compare import Descriptor


def join(
    scene: PhotographTarget,
    coarse: CoarseFit,
    others: Sequence[tuple[Photo, CoarseFit]],
    detail: int,
) -> tuple[PhotographTarget, list[dict[str, Any]]]:
    """Add the windows of other photographs to a target; also a JSON entry of each one's fit.

    Args:
        scene, coarse: of the first photograph.
        others: more photographs of the same sample, with their fits.
        detail: texels across each.

    Raises:
        MatcapError: a photograph is too narrow to hold a window.
    """
    windows, setups, documents = [scene.windows], [], []
    for photo, fit in others:
        plane = read_plane(photo, fit.setup, detail)
        if min(plane.size) < scene.windows.size:
            raise MatcapError.at(
                photo.name,
                f"at {plane.size[0]} x {plane.size[1]} texels it is too narrow",
                "raise --detail, or leave the photograph out",
            )
        gain = _brightness(coarse) / _brightness(fit)
        compared = replace(plane.brightened(gain), encoding=scene.encoding)
        windows.append(cut_windows(compared, scene.bank, scene.windows.size))
        setups.append(fit.setup.with_intensity(scene.setup.intensity))
        documents.append(
            {
                "photograph": photo.name,
                "tilt_degrees": [math.degrees(angle) for angle in fit.setup.tilt],
                "flash_offset": list(fit.setup.offset),
                "vignetting": fit.setup.vignetting,
                "vignetting_quartic": fit.setup.vignetting_quartic,
                "vignetting_centre": list(fit.setup.vignetting_centre),
                "gain": gain,
            }
        )
    joined = Windows(
        scene.windows.size,
        torch.cat([each.points for each in windows]),
        Descriptor.joined([each.target for each in windows]),
        _joined_noise(windows),
        torch.cat([torch.full((each.count,), n) for n, each in enumerate(windows)]),
    )
    return replace(scene, windows=joined, others=tuple(setups)), documents


def _joined_noise(windows: Sequence[Windows]) -> Tensor | None:
    """Noise of all windows, 0 where unknown; None if it is unknown of all."""
    if all(each.noise is None for each in windows):
        return None
    return torch.cat(
        [torch.zeros_like(each.points) if each.noise is None else each.noise for each in windows]
    )


def _brightness(fit: CoarseFit) -> float:
    """Mean diffuse albedo times flash intensity (green), a product that one photograph measures."""
    return sum(fit.diffuse) / 3.0 * fit.setup.intensity[1]
