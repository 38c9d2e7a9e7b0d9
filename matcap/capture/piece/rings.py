"""What a map has in rings around the flash's foot: the highlight did it, not the material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.tuned import RINGS


@dataclass(frozen=True)
class Rings:
    """Rings around a place, each in sectors.

    Attributes:
        away: (H, W) texels from it.
        places: (H, W) number of the sector.
        count: (rings, sectors) texels in each.
    """

    away: NDArray[np.float32]
    places: NDArray[np.int64]
    count: NDArray[np.float64]

    @staticmethod
    def around(foot: tuple[float, float], shape: tuple[int, ...]) -> Rings:
        """Around a place in plane units, of a plane (H, W)."""
        height, width = shape
        v, u = np.mgrid[:height, :width] + 0.5
        x = u - (foot[0] + 1.0) * width / 2.0
        y = height / 2.0 - foot[1] * width / 2.0 - v
        away = np.hypot(x, y)
        ring = (away / RINGS.width).astype(np.int64)
        turn = (np.arctan2(y, x) / (2.0 * np.pi) % 1.0 * RINGS.sectors).astype(np.int64)
        places = ring * RINGS.sectors + turn % RINGS.sectors
        size = (int(ring.max()) + 1) * RINGS.sectors
        count = np.bincount(places.ravel(), minlength=size).reshape(-1, RINGS.sectors)
        return Rings(away.astype(np.float32), places, count.astype(np.float64))

    def marked(self, plane: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) what goes with the distance alone, as far as chance does not explain it.

        A drawing differs from sector to sector of a ring, what the light has left does not: the
        scatter of sectors says what their mean is by chance, and is held against it (as James and
        Stein 1961 shrink means).
        """
        sums = np.bincount(self.places.ravel(), plane.ravel(), self.count.size)
        seen = self.count > 0.0
        means = sums.reshape(self.count.shape) / np.maximum(self.count, 1.0) - float(plane.mean())
        sectors = np.maximum(seen.sum(1), 1)
        mean = (means * seen).sum(1) / sectors
        scatter = (np.square(means - mean[:, None]) * seen).sum(1) / np.maximum(sectors - 1, 1)
        chance = RINGS.doubt * scatter / sectors
        kept = np.where(
            sectors > RINGS.sectors // 2, 1.0 - chance / np.maximum(np.square(mean), 1e-12), 0.0
        )
        profile = mean * kept.clip(0.0, 1.0)
        middles = (np.arange(len(profile)) + 0.5) * RINGS.width
        # Nearer to the foot all sectors show the same features: a disc goes on as its rim is.
        far = middles >= RINGS.nearest
        return np.asarray(np.interp(self.away, middles[far], profile[far]), np.float32)
