"""A photograph at the start of its capture: fitted and rectified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matcap.capture.detail import Rectified
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import Plane
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class CaptureStart:
    """A photograph after the coarse fit.

    Attributes:
        photo: the photograph, linear.
        coarse: its coarse fit.
        rectified: the photograph on its plane.
        window: side of the comparison windows, texels.
        others: more photographs of the same sample.
    """

    photo: Photo
    coarse: CoarseFit
    rectified: Rectified
    window: int
    others: Sequence[Photo] = ()

    @property
    def plane(self) -> Plane:
        """The photograph at the network's resolution."""
        return self.rectified.network_input

    @property
    def waves(self) -> tuple[Wave, ...]:
        """Frequency vectors of its lattice, cycles per texel of `plane`."""
        return self.rectified.input_waves
