"""What a photograph says of its piece before anything is made of it."""

from __future__ import annotations

import torch

from matcap.capture.coarse import fit_coarse
from matcap.capture.exemplar.find import noise_level
from matcap.capture.exemplar.strengths import Strengths, measure_strengths
from matcap.flash.geometry import plane_points
from matcap.flash.plane import read_plane
from matcap.model.inverse.inputs import network_inputs
from matcap.model.inverse.network import COLOUR, SHOWN
from matcap.photo.photo import Photo


@torch.no_grad()
def photographed_strengths(photo: Photo, detail: int) -> Strengths | None:
    """Strengths of relief and albedo; None where too little of the photograph can be used.

    Args:
        photo: the photograph.
        detail: texels across its long side, in which bands are counted.

    Raises:
        MatcapError: nothing can be fitted to it.
    """
    coarse = fit_coarse(photo)
    plane = read_plane(photo, coarse.setup, detail)
    width, height = plane.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    inputs = network_inputs(plane.linear, plane.valid, coarse, points)
    return measure_strengths(
        inputs[COLOUR].mean(0).numpy(),
        inputs[SHOWN].numpy(),
        plane.valid.numpy(),
        noise_level(plane),
    )
