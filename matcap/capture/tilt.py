"""The coarse fit with the alignment branch's tilt as a prior."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matcap.field.single import one_thread
from matcap.flash.coarse.fit import CoarseFit, fit_coarse, rescale_to_flash
from matcap.flash.coarse.hypotheses import TiltPrior
from matcap.photo.photo import Photo
from matcap.space.alignment import tilt_measurement


@one_thread()
def fit_photograph(photo: Photo, *, measured: bool = True) -> CoarseFit:
    """Coarse fit of a photograph, with the alignment branch's two tilt angles as Gaussian prior.

    Albedo is absolute where the flash intensity is known.

    Args:
        photo: the photograph.
        measured: whether to use the alignment branch.
    """
    prior = None
    if measured:
        seen = tilt_measurement(photo)
        prior = TiltPrior((seen.x, seen.y), (seen.std_x, seen.std_y))
    return rescale_to_flash(fit_coarse(photo, tilt_prior=prior), photo.flash_intensity)


def tilt_document(coarse: CoarseFit) -> dict[str, Any] | None:
    """Tilt about x and y by source, degrees; None without a measurement.

    Keys: `used`; `branch`, the alignment branch's, with its standard deviation `branch_std`; and
    `picture`, the coarse fit's without the branch.
    """
    if coarse.tilt_prior is None or coarse.picture_tilt is None:
        return None
    return {
        "used": _degrees(coarse.setup.tilt),
        "branch": _degrees(coarse.tilt_prior.mean),
        "branch_std": _degrees(coarse.tilt_prior.std),
        "picture": _degrees(coarse.picture_tilt),
    }


def tilt_line(document: Mapping[str, Any]) -> str:
    """One sentence from a tilt_document."""
    x, y = document["used"]
    bx, by = document["branch"]
    sx, sy = document["branch_std"]
    px, py = document["picture"]
    return (
        f"Tilt about x and y: {x:.1f} and {y:.1f} degrees; the alignment branch says {bx:.1f} "
        f"and {by:.1f} (standard deviations {sx:.1f} and {sy:.1f}), the picture alone {px:.1f} "
        f"and {py:.1f}."
    )


def _degrees(angles: Sequence[float]) -> list[float]:
    return [round(math.degrees(angle), 2) for angle in angles]
