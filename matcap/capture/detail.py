"""Resolution of the exemplar, and of the grid on which the network reads it.

The piece has as many as are asked for. The network joins what lies within some hundred texels, and
windows of 160 are compared. What is coarser comes out as grain of the right colours, wood as
sawdust; read on half as many texels across the same pattern spans half as many, and the capture
holds it. Finer bands are carried over from the photograph (piece/finest.py). Figures in
docs/notes/capture.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.settings import DETAIL
from matcap.flash.mirror import lit_mirror
from matcap.flash.plane import Plane, read_plane
from matcap.flash.uniform import Uniform
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave, find_lattice

UNION_TIMES = 4  # a piece of several photographs over the first one's texels, at most


@dataclass(frozen=True)
class DetailSettings:
    """Detection of coarse textures; docs/notes/capture.md."""

    scales: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    """Texels: deviations of the blurs between the bands."""
    most_coarse: float = 0.08
    """Share of the variance in the last band, waves from some 100 to 200 texels."""
    faintest: float = 1e-4
    """Linear: bounds the logarithm in the dark."""
    strongest: float = 3.0
    """Log radiance from the median: larger departures count as this large."""


COARSENESS = DetailSettings()


def coarse_share(linear: Tensor, valid: Tensor) -> float:
    """Share of a texture's variance that lies in its coarsest band, in [0, 1].

    Of log luminance, so that bright and dim regions count alike. Coarser still is shading.

    Args:
        linear: (3, H, W) picture of the plane, DETAIL texels across.
        valid: (H, W) bool, texels seen and not clipped.
    """
    seen = valid.numpy().astype(np.float32)
    if not seen.any():
        return 0.0
    log = np.log(np.maximum(linear.mean(0).numpy(), COARSENESS.faintest))
    middle = float(np.median(log[seen > 0.0]))
    finer = (log - middle).clip(-COARSENESS.strongest, COARSENESS.strongest)
    variances = []
    for scale in COARSENESS.scales:
        # What is left varies over as much as the last blur's deviation, half this one's: from
        # 2 texels on every other texel says as much.
        if scale > 2.0:
            finer, seen = _halved(finer), _halved(seen)
        deviation = min(scale, 2.0)
        weight = np.maximum(_blur(seen, deviation), 1e-3)
        blurred = _blur(finer * seen, deviation) / weight
        variances.append(float(np.average(np.square(finer - blurred), weights=seen)))
        finer = blurred
    whole = sum(variances)
    return variances[-1] / whole if whole > 0.0 else 0.0


def _blur(picture: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    # OpenCV's own border leaves out the outermost texel, which is wide once halved.
    blurred = cv2.GaussianBlur(picture, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float32)


def _halved(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    size = tuple(max(1, side // 2) for side in picture.shape[::-1])
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def detail_for(linear: Tensor, valid: Tensor) -> int:
    """Texels across to read a texture without a lattice on: DETAIL, or half of it if coarse."""
    return DETAIL // 2 if coarse_share(linear, valid) > COARSENESS.most_coarse else DETAIL


@dataclass(frozen=True)
class Rectified:
    """A photograph on the plane of its sample, and its regular order.

    Attributes:
        whole: on as many texels as the piece is to have.
        waves: plane waves of its lattice, cycles a texel of the whole; none where it has none.
        read: the photograph on as many texels as it is best read on.
    """

    whole: Plane
    waves: tuple[Wave, ...]
    read: Plane

    @staticmethod
    def of(plane: Plane, waves: tuple[Wave, ...] = ()) -> Rectified:
        """Of a plane, whose waves the network receives as input, however long their period."""
        columns = plane.size[0]
        usual = plane.shrunk(DETAIL) if columns > DETAIL else plane
        suited = usual
        if columns >= DETAIL and not waves:
            wanted = detail_for(usual.linear, usual.valid)
            suited = plane.shrunk(wanted) if wanted != DETAIL else usual
        return Rectified(plane, waves, suited)

    @staticmethod
    def of_photo(photo: Photo, fit: Uniform, detail: int) -> Rectified:
        """Of a photograph read with at least as many pixels as `detail` texels across.

        Args:
            photo: the photograph.
            fit: its coarse fit.
            detail: texels across.
        """
        plane = read_plane(photo, fit.setup, detail)
        lattice = find_lattice(plane.encoded(), plane.valid)
        return Rectified.of(lit_mirror(plane, fit), lattice.waves)

    @property
    def read_waves(self) -> tuple[Wave, ...]:
        """Cycles a texel of what is read."""
        longer = self.whole.size[0] / self.read.size[0]
        return tuple(Wave(longer * wave.fx, longer * wave.fy) for wave in self.waves)

    def as_read(self) -> Rectified:
        """As of a piece that is to have no more texels than are read."""
        return Rectified(self.read, self.read_waves, self.read)
