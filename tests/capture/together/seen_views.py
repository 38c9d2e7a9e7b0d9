"""Photographs of pieces of a few texels by the renderer itself, on the maps' own grid."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.together.texels import log_rendered, parameters_of, points_of
from matcap.capture.together.views import ResampledView, SharedLight, light_at
from matcap.lab.simulate.hand_held import Hand, hold
from matcap.lab.simulate.photograph import PhoneCamera

PHONE = PhoneCamera(width=640, height=480)
SIZE = (48, 64)  # texels
OFFSET = (0.04, -0.07)  # the flash's, from the lens
# As of a network that hardly knows: log of what each number is off by, (4, 1, 1).
DOUBT = torch.log(torch.tensor([0.5, 0.2, 0.2, 0.15]))[:, None, None]


def seen(pieces: Sequence[MapSet], noise: float = 0.0) -> tuple[list[ResampledView], SharedLight]:
    """A photograph of each from elsewhere, its log radiance off by `noise`, and their light."""
    count = len(pieces)
    nowhere, strength = torch.zeros(count, 3), torch.full((3,), 5.0)
    light = SharedLight(torch.tensor(OFFSET), torch.zeros(2), nowhere, strength)
    generator = torch.Generator().manual_seed(3)
    views = []
    for number, (camera, maps) in enumerate(
        zip(hold(PHONE, Hand(), count, 1), pieces, strict=True)
    ):
        empty = torch.zeros(3, *SIZE)
        view = ResampledView(empty, empty == 0.0, camera)
        lit = light_at(number, view, light, points_of(SIZE))
        log = log_rendered(parameters_of(maps), [lit])[0]
        views.append(replace(view, log=log + noise * torch.randn(log.shape, generator=generator)))
    return views, light
