"""The coarse fit's model: parameters, and log radiance of a uniform material in the camera frame.

With the diffuse albedo a (0.005 F0 of a conductor), roughness r, and E the irradiance of
flash/light.py,

    log L = log(a E / pi + specular(F0, r) E) - vignetting.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.parameters import Reflectance
from matcap.flash.light import FlashLight, log_vignette

_DARKEST = 1e-12  # radiance added before logarithms
BLACK = 0.005  # diffuse albedo of a conductor over its F0


@dataclass(frozen=True)
class Unknowns:
    """The fitted parameters, scaled to order 1."""

    albedo: Tensor
    """(3,) log of diffuse albedo; of a conductor, log of F0."""
    specular: Tensor
    """(1,) log of a dielectric's F0."""
    roughness: Tensor
    """(1,) logit."""
    intensity: Tensor
    """(1,) log of the flash's, in green."""
    flash_colour: Tensor
    """(2,) log of the flash's intensity in red and in blue over that."""
    offset: Tensor
    """(2,) of the flash from the camera, plane units."""
    tilt: Tensor
    """(2,) radians."""
    vignetting: Tensor
    """(2,) with r^2 and with r^4, as FlashSetup has them."""
    centre: Tensor
    """(2,) of the vignetting, image coordinates."""
    tone: Tensor
    """(1,) log of the tone curve's exponent."""

    def vector(self) -> Tensor:
        """(17,) all of them."""
        return torch.cat([getattr(self, f.name) for f in fields(self)])

    @staticmethod
    def of(vector: Tensor) -> Unknowns:
        """The inverse of vector()."""
        return Unknowns(*vector.split((3, 1, 1, 1, 2, 2, 2, 2, 2, 1)))

    @property
    def flash(self) -> Tensor:
        """(3,) log of the flash's intensity by channel."""
        red, blue = (self.intensity + self.flash_colour).split(1)
        return torch.cat([red, self.intensity, blue])


INDEX = Unknowns.of(torch.arange(17))  # of each unknown in vector()


def numbers(*values: float) -> Tensor:
    """A float64 vector."""
    return torch.tensor(values, dtype=torch.float64)


def log_radiance(
    unknowns: Unknowns, image: Tensor, distance: float, *, conductor: bool = False
) -> Tensor:
    """(3, n) log radiance of the uniform material.

    Args:
        unknowns: the parameters.
        image: (2, n) image coordinates.
        distance: of the camera, plane units.
        conductor: `albedo` is F0, and hardly anything is diffuse.
    """
    normal, camera, flash = _places(unknowns, distance)
    image = image[:, None]
    # Points where the rays meet the tilted plane.
    ray = torch.cat([image, torch.full_like(image[:1], -distance)])
    along = -(normal[2] * distance) / torch.tensordot(normal, ray, dims=1)
    points = camera[:, None, None] + along * ray
    light = FlashLight.between(points, camera, flash, unknowns.flash.exp()[:, None, None])
    incidence = light.onto(normal[:, None, None].expand_as(points), exact=True)
    colour = unknowns.albedo.exp()[:, None, None]
    surface = Reflectance(
        colour * (BLACK if conductor else 1.0),
        colour if conductor else unknowns.specular.exp()[:, None, None],
        torch.sigmoid(unknowns.roughness)[:, None, None],
    )
    lost = log_vignette(image - unknowns.centre[:, None, None], *unknowns.vignetting)
    return ((incidence.radiance(*surface) + _DARKEST).log() + lost).flatten(1)


def mirror_point(unknowns: Unknowns, distance: float) -> Tensor:
    """(2,) image coordinates of the mirror point."""
    normal, camera, light = _places(unknowns, distance)
    height_camera, height_light = (normal * camera).sum(), (normal * light).sum()
    foot_camera, foot_light = camera - height_camera * normal, light - height_light * normal
    point = (foot_camera * height_light + foot_light * height_camera) / (
        height_camera + height_light
    )
    return point[:2] * (distance / (distance - point[2]))


def _places(unknowns: Unknowns, distance: float) -> tuple[Tensor, Tensor, Tensor]:
    """(3,) each, in the camera frame: the plane's normal, places of camera and flash."""
    (sine_x, sine_y), (cosine_x, cosine_y) = unknowns.tilt.sin(), unknowns.tilt.cos()
    normal = torch.stack(
        [sine_y * cosine_x, -sine_x, cosine_y * cosine_x]
    )  # setup_rotation()[:, 2]
    camera = numbers(0.0, 0.0, distance)
    return normal, camera, camera + F.pad(unknowns.offset, (0, 1))
