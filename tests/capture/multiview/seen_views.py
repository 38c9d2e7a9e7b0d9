"""Small maps, and their photographs by the renderer on the maps' own grid."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, as_photo, hold, take_several

from matcap.brdf.maps import MapSet
from matcap.capture.multiview.texels import log_rendered, parameters_of
from matcap.capture.multiview.views import ResampledView, SharedLight, light_at
from matcap.capture.registration.camera import PosedCamera
from matcap.flash.geometry import points_of

PHONE, HAND = PhoneCamera(width=640, height=480), Hand()
SIZE = (48, 64)  # texels
OFFSET = (0.04, -0.07)  # the flash's, from the lens
# Log errors (4, 1, 1) of an uncertain prediction.
LOG_ERROR = torch.log(torch.tensor([0.5, 0.2, 0.2, 0.15]))[:, None, None]


def photographed(name, phone, count, seed, hand=HAND, first=0):
    """Cameras and photographs of a material by a hand-held phone, numbered from `first`."""
    cameras = hold(phone, hand, count, seed)
    shots = enumerate(take_several(piece(name), phone, cameras, hand, seed), first)
    return cameras, [as_photo(one, n, f"{name}_{n}") for n, one in shots]


def grainy(seed: int, size: tuple[int, int] = SIZE, *, albedo: float = 0.2) -> MapSet:
    """Maps of a rough relief and independent blots of albedo."""
    rng, texel = np.random.default_rng(seed), 2.0 / size[1]

    def grain(deviation: float) -> torch.Tensor:
        noise = cv2.GaussianBlur(rng.normal(size=size), (0, 0), deviation)
        return torch.from_numpy(noise / noise.std()).float()[None]

    return MapSet(
        diffuse=(0.3 * (albedo * grain(3.0)).exp()).expand(3, -1, -1).contiguous(),
        specular=torch.full((1, *size), 0.04),
        roughness=torch.full((1, *size), 0.6),
        height=0.25 * texel * grain(2.0),
        texel_size=texel,
    )


def flattened(maps: MapSet) -> MapSet:
    """Maps of the same mean without detail."""
    mean = maps.diffuse.mean((1, 2), keepdim=True).expand_as(maps.diffuse).contiguous()
    return replace(maps, diffuse=mean, height=torch.zeros_like(maps.height))


def seen_by(
    camera: PosedCamera, number: int, maps: MapSet, light: SharedLight, *, flash: bool = True
) -> ResampledView:
    """Photograph `number` of maps by a camera, in its flash or in ambient light."""
    width, height = maps.size
    empty = torch.zeros(3, height, width)
    view = ResampledView(empty, empty == 0.0, camera, flash)
    lit = light_at(number, view, light, points_of((height, width)))
    return replace(view, log=log_rendered(parameters_of(maps), [lit])[0])


def seen(pieces: Sequence[MapSet], noise: float = 0.0) -> tuple[list[ResampledView], SharedLight]:
    """A photograph of each from elsewhere, its log radiance off by `noise`, and their light."""
    count = len(pieces)
    nowhere, strength = torch.zeros(count, 3), torch.full((3,), 5.0)
    light = SharedLight(torch.tensor(OFFSET), torch.zeros(2), nowhere, strength)
    generator = torch.Generator().manual_seed(3)
    views = []
    for number, (camera, maps) in enumerate(zip(hold(PHONE, HAND, count, 1), pieces, strict=True)):
        view = seen_by(camera, number, maps, light)
        off = noise * torch.randn(view.log.shape, generator=generator)
        views.append(replace(view, log=view.log + off))
    return views, light
