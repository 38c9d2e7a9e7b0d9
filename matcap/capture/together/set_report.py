"""The report on several photographs of one sample that were solved together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from matcap.capture.together.align import Aligned
from matcap.capture.together.predict import Predictions
from matcap.capture.together.solve import Solved
from matcap.capture.together.union import Reach
from matcap.flash.registration.doubt import DOUBTED
from matcap.flash.registration.register import LeftOut, RegisteredView, Registration


@dataclass(frozen=True)
class SetReport:
    """Cameras, residuals and measured shares of photographs that were solved together."""

    views: tuple[RegisteredView, ...]
    """Those that were used, each with its camera, the first one first."""
    residuals: tuple[float, ...]
    """Median difference of log radiance between each and its re-rendering."""
    predicted: tuple[float, ...]
    """The same of each when all the others alone decide, on the same texels (predict.py); NaN of
    one by ambient light; empty where it was not computed."""
    left_out: tuple[LeftOut, ...]
    """Those that were not used, and why."""
    measured: tuple[float, float, float, float]
    """Share of maps that was measured rather than read: albedo, F0, roughness, relief."""
    flash_offset: tuple[float, float]
    """Of all photographs."""
    bent: tuple[float, float]
    """The lens's distortion."""
    reach: Reach | None = None
    """How far the piece reaches beyond the first photograph; None where it does not."""

    @staticmethod
    def of(
        registration: Registration,
        alignment: Aligned,
        solved: Solved,
        ahead: Predictions | None,
        reach: Reach | None = None,
    ) -> SetReport:
        """Of the registered, aligned and solved set."""
        x, y = solved.light.offset.tolist()
        return SetReport(
            alignment.views,
            solved.residual if ahead is None else _known(ahead.residual, solved.residual),
            () if ahead is None else ahead.predicted,
            registration.left_out,
            solved.measured,
            (x, y),
            alignment.views[0].camera.lens.bent,
            reach if reach is not None and reach.margins.any else None,
        )

    def doubted(self) -> str | None:
        """A sentence if a camera's standard deviation exceeds the limit, else None."""
        far = [view for view in self.views if view.doubt > DOUBTED]
        if not far:
            return None
        worst, names = max(view.doubt for view in far), ", ".join(v.photo.name for v in far)
        return (
            f"Camera positions are uncertain by {100 * worst:.1f} % of their distance ({names}), "
            "and so are directions of light: relief may lean slightly."
        )

    def document(self) -> dict[str, Any]:
        """JSON: angles in degrees, places in plane units."""
        predicted = self.predicted or (None,) * len(self.views)
        return {
            "photographs": [
                {
                    "name": view.photo.name,
                    "flash": view.flash,
                    "matches": view.matches,
                    "likeness": view.alike,
                    "place": view.camera.place.tolist(),
                    "tilt_degrees": math.degrees(view.camera.tilt),
                    "doubt": view.doubt,
                    "residual": residual,
                    "predicted": None if ahead is None or math.isnan(ahead) else ahead,
                }
                for view, residual, ahead in zip(self.views, self.residuals, predicted, strict=True)
            ],
            "left_out": [{"name": one.name, "why": one.why} for one in self.left_out],
            "measured_share": dict(
                zip(("diffuse", "specular", "roughness", "height"), self.measured, strict=True)
            ),
            "flash_offset": list(self.flash_offset),
            "lens_distortion": list(self.bent),
            **({} if self.reach is None else {"union": self.reach.document()}),
        }


def _known(first: tuple[float, ...], otherwise: tuple[float, ...]) -> tuple[float, ...]:
    both = zip(first, otherwise, strict=True)
    return tuple(other if math.isnan(one) else one for one, other in both)
