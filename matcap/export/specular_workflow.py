"""The model of glTF and UsdPreviewSurface: diffuse below a specular layer.

Both give matcap's specular part exactly, and multiply the diffuse part by 1 - F(v.h). A base
colour of diffuse / (1 - F0) takes F0 out of that again; what is left, a factor of
1 - (1 - v.h)^5, shows where light and view are far apart.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matcap.export.textures import ExportJob


def base_colour(job: ExportJob) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """(H, W, 3) base colour in [0, 1], and what must be said of it."""
    rest = np.maximum(1.0 - job.picture("specular"), 1e-6)[..., None]
    base = job.picture("diffuse") / rest
    clipped = float((base.max(axis=-1) > 1.0).mean())
    notes: tuple[str, ...] = ()
    if clipped > 0.0:
        notes = (
            f"{clipped:.2%} of the texels reflect more than a layered model allows; "
            "their base colour is clipped",
        )
    colour: NDArray[np.float32] = np.clip(base, 0.0, 1.0).astype(np.float32)
    return colour, notes
