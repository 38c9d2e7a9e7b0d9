"""Report on several photographs of one sample: cameras, residuals, measured shares."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from matcap.brdf.maps import CHANNELS
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.registration.register import LeftOut, RegisteredView
from matcap.photo.checks import CHECKS


@dataclass(frozen=True)
class SetReport:
    """Result of a multi-view solve, by photograph."""

    views: tuple[RegisteredView, ...]
    """Registered photographs, the first one first."""
    residuals: tuple[float, ...]
    """Median |log radiance of photograph - re-rendering| of each."""
    predicted: tuple[float, ...]
    """Residuals of maps from all other photographs (leave_one_out.py); NaN without flash; empty if
    not computed."""
    left_out: tuple[LeftOut, ...]
    """Photographs that could not be registered, with reasons."""
    measured: tuple[float, ...]
    """Share of albedo, F0, roughness and slope measured by photographs (Solved.measured)."""
    flash_offset: tuple[float, float, float]
    """Position of the flash relative to the lens, plane units; the last is 0."""
    mosaic: Mosaic
    """Extent of the maps; without margins, the first photograph's rectangle."""

    def by_view(self) -> Iterator[tuple[RegisteredView, float, float]]:
        """Each view with its residual and the residual of its prediction; NaN if not computed."""
        predicted = self.predicted or (math.nan,) * len(self.views)
        return zip(self.views, self.residuals, predicted, strict=True)

    def warning(self) -> str | None:
        """A sentence if a camera's standard deviation exceeds the limit, else None."""
        (limit,) = CHECKS["cameras"].limits
        uncertain = [view for view in self.views if view.position_deviation > limit]
        if not uncertain:
            return None
        worst = max(view.position_deviation for view in uncertain)
        names = ", ".join(view.photo.name for view in uncertain)
        return (
            f"Camera positions are uncertain by {100 * worst:.1f} % of their distance ({names}), "
            "and so are directions of light: the relief may be slightly tilted."
        )

    def document(self) -> dict[str, Any]:
        """JSON: angles in degrees, places in plane units."""
        return {
            "photographs": [
                {
                    "name": view.photo.name,
                    "flash": view.flash,
                    "matches": view.matches,
                    "correlation": view.correlation,
                    "position": view.camera.place.tolist(),
                    "tilt_degrees": math.degrees(view.camera.tilt),
                    "position_deviation": view.position_deviation,
                    "residual": residual,
                    "leave_one_out_residual": None if math.isnan(prediction) else prediction,
                }
                for view, residual, prediction in self.by_view()
            ],
            "left_out": [{"name": one.name, "reason": one.why} for one in self.left_out],
            "measured_share": dict(zip(CHANNELS, self.measured, strict=True)),
            "flash_offset": list(self.flash_offset[:2]),
            "lens_distortion": list(self.views[0].camera.lens.distortion),
            **({"mosaic": self.mosaic.document()} if self.mosaic.margins.any else {}),
        }
