"""Relief and albedo energies of a photograph, before its maps are estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.piece.network.network import NetworkInputs
from matcap.capture.piece.noise import channel_noise, channel_weights, noise_level
from matcap.capture.piece.smooth import filled, smoothed
from matcap.capture.piece.strengths import Strengths, measure_strengths
from matcap.capture.piece.tuned import STRENGTH
from matcap.flash.plane import Plane


def plane_strengths(
    plane: Plane, inputs: NetworkInputs, read: Tensor | None = None
) -> Strengths | None:
    """Strengths of relief and albedo; None where too little of the photograph can be used.

    The sensitivity to slope is the coarse fit's, which is nearer to the truth than that of the
    predicted maps (docs/notes/capture.md); the difference of both adds to the deviation.

    Args:
        plane: the photograph; bands are counted in its texels.
        inputs: of the network.
        read: (2, H, W) d log L / d slope of the predicted maps. Bare metal between rust has three
            times the sensitivity of both together.
    """
    use = plane.measured.numpy()
    channels = inputs.log.numpy()
    # What is clipped is at least as bright as it looks.
    whole = [np.maximum(filled(c, u), c) for c, u in zip(channels, use, strict=True)]
    return measure_strengths(
        np.asarray((channel_weights(channel_noise(plane)).numpy() * whole).sum(0), np.float32),
        _even(inputs.slope_sensitivity),
        use.mean(0, dtype=np.float32),
        noise_level(plane),
        matte=(1.0 - inputs.gloss[0]).clamp(0.0, 1.0).numpy(),
        also=None if read is None else _even(read),
    )


def _even(shown: Tensor) -> NDArray[np.float32]:
    """Responses (2, H, W) of neighbourhoods."""
    return np.stack([smoothed(s, STRENGTH.response_around) for s in shown.numpy()])
