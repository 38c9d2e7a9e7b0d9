"""The coarse fit: a handful of numbers for a photograph's smooth part (DESIGN, section 6).

A flat, uniform material under a flash is fitted to the blurred photograph by robust least squares
on the logarithm of radiance: albedo, F0, roughness, flash intensity and offset, tilt, vignetting.
Clipped cells are lower bounds. Weak priors decide what one photograph cannot: how much of the
brightness is flash and how much is albedo, or a little tilt from a little offset. Several starting
points, because the highlight's width has local minima.

What it leaves out: texture. A bumpy surface spreads its highlight, so the roughness found here is
an upper estimate; fine-tuning brings it down as bumps appear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import cook_torrance, dot, normalize
from matcap.flash.geometry import FlashSetup, rotation
from matcap.photo.photo import Photo

# Cells across the long side: fine enough for a glossy highlight, coarse enough to be instant.
_CELLS = 64
# A developed picture compresses its brightest tones before it clips them; above this share of the
# clip level its cells are lower bounds. RAW is linear up to the clip level itself.
_KNEE_DEVELOPED, _KNEE_RADIOMETRIC = 0.6, 0.95
_HUBER = 0.1  # in log radiance: beyond 10 % a residual counts linearly
_ITERATIONS = 40  # of Levenberg-Marquardt, at most
_STEP = 1e-5  # of a parameter, all of which are of order 1
# A developed picture's tone curve deepens the falloff; a RAW's numbers are the light's own, and
# only what a lens profile left undone remains.
_VIGNETTING_RADIOMETRIC = (0.0, 0.05)
_BRIGHTEST = 0.8  # mean albedo or F0 of the brightest material believed in
_MOST_ALBEDO = 0.98  # or F0, under a known flash: no surface gives back all
# One prior deviation weighs like residuals of _HUBER in this share of the cells: cells are far
# from independent, since what the model lacks (blotches, and tone mapping where the picture was
# developed) is smooth.
_PRIOR_SHARE_DEVELOPED, _PRIOR_SHARE_RADIOMETRIC = 0.15, 0.03


@dataclass(frozen=True)
class CoarseFit:
    """A uniform material and the setup it was photographed with.

    Attributes:
        diffuse: (r, g, b) albedo in (0, 1).
        specular: F0 in (0, 1).
        roughness: in (0, 1).
        setup: camera, flash and tilt; its intensity belongs to these albedos.
        residual: root-mean-square of the log residual over unclipped cells.
    """

    diffuse: tuple[float, float, float]
    specular: float
    roughness: float
    setup: FlashSetup
    residual: float


# The unknowns, in the unit each is solved in: log red, green, blue albedo, log F0, logit roughness,
# log intensity, offset x and y, tilt x and y, vignetting; prior means and deviations.
_PRIOR_MEAN = torch.tensor(
    [math.log(0.25)] * 3 + [math.log(0.04), 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.4], dtype=torch.float64
)
_PRIOR_DEVIATION = torch.tensor(
    [0.8, 0.8, 0.8, 0.4, 1.5, 5.0, 0.12, 0.12, 0.05, 0.05, 0.6], dtype=torch.float64
)
# (log F0, logit roughness, offset of the log albedo): matt, satin, glossy, mirror-like, metal.
_STARTS = (
    (math.log(0.04), 0.8, 0.0),
    (math.log(0.04), -0.4, 0.0),
    (math.log(0.05), -1.4, -0.5),
    (math.log(0.04), -2.2, 0.0),
    (math.log(0.5), -0.4, -2.0),
)


def fit_coarse(photo: Photo, *, tilt: tuple[float, float] | None = None) -> CoarseFit:
    """Fit a uniform material and its setup to a photograph, in about a second.

    Args:
        photo: any size; only its blurred form is looked at.
        tilt: (tilt_x, tilt_y) in radians when something better knows them (the alignment branch);
            held fixed then.
    """
    cells, bounded = _cells(photo)
    distance = FlashSetup(fov=photo.fov).distance
    observed = torch.from_numpy(np.log(cells)).permute(2, 0, 1)
    lower_bound = torch.from_numpy(bounded)[None]
    height, width = cells.shape[:2]
    image = _image_grid(width, height)

    deviation = _PRIOR_DEVIATION.clone()
    centre = _PRIOR_MEAN.clone()
    if photo.radiometric:
        centre[10], deviation[10] = _VIGNETTING_RADIOMETRIC
    if tilt is not None:
        centre[8], centre[9] = tilt
        deviation[8:10] = 1e-4

    def residuals(parameters: Tensor) -> Tensor:
        difference = _log_radiance(parameters, image, distance) - observed
        # A lower bound only complains when the model stays below it.
        difference = torch.where(lower_bound, difference.clamp_max(0.0), difference)
        return difference.flatten()

    prior_share = _PRIOR_SHARE_RADIOMETRIC if photo.radiometric else _PRIOR_SHARE_DEVELOPED
    weight = prior_share * 3.0 * width * height * _HUBER**2

    def solve(start: Tensor) -> tuple[float, Tensor]:
        return _levenberg_marquardt(residuals, start, centre, weight / deviation.square())

    best = min((solve(start) for start in _starts(observed, centre)), key=lambda found: found[0])[1]
    rest = residuals(best)[(~lower_bound).expand(3, -1, -1).flatten()]
    values = best.tolist()
    # Only ratios are seen: albedos brighter than paper mean a brighter flash.
    excess = max(0.0, max(values[:4]) - math.log(_BRIGHTEST))
    diffuse = [math.exp(value - excess) for value in values[:3]]
    return CoarseFit(
        diffuse=(diffuse[0], diffuse[1], diffuse[2]),
        specular=math.exp(values[3] - excess),
        roughness=1.0 / (1.0 + math.exp(-values[4])),
        setup=FlashSetup(
            fov=photo.fov,
            offset=(values[6], values[7], 0.0),
            tilt=(values[8], values[9]),
            intensity=(math.exp(values[5] + excess),) * 3,
            vignetting=values[10],
        ),
        residual=float(rest.square().mean().sqrt()) if rest.numel() else 0.0,
    )


def under_flash(coarse: CoarseFit, intensity: float | None) -> CoarseFit:
    """The same picture under a flash of known intensity: albedo becomes absolute.

    Args:
        coarse: the fit, whose intensity was believed.
        intensity: that a calibration card told, in the units of the photograph's pixels; None
            leaves the fit as it is.
    """
    if intensity is None:
        return coarse
    dimmer = coarse.setup.intensity[1] / intensity
    red, green, blue = (min(value * dimmer, _MOST_ALBEDO) for value in coarse.diffuse)
    return replace(
        coarse,
        diffuse=(red, green, blue),
        specular=min(coarse.specular * dimmer, _MOST_ALBEDO),
        setup=coarse.setup.with_intensity((intensity,) * 3),
    )


def _cells(photo: Photo) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Blurred photograph (h, w, 3), positive, and which cells are lower bounds (h, w)."""
    width = _CELLS
    height = max(8, round(_CELLS * photo.pixels.shape[0] / photo.pixels.shape[1]))
    small = cv2.resize(photo.pixels, (width, height), interpolation=cv2.INTER_AREA)
    share = cv2.resize(
        photo.clipped.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA
    )
    knee = _KNEE_RADIOMETRIC if photo.radiometric else _KNEE_DEVELOPED
    bounded = (share > 0.02) | (small.max(axis=2) > knee)
    floor = 1e-3 * float(np.quantile(small, 0.5)) + 1e-9
    return np.maximum(small, floor).astype(np.float64), bounded


def _image_grid(width: int, height: int) -> Tensor:
    """(2, h, w) image coordinates of cell centres, long side in [-1, 1]."""
    u = (torch.arange(width, dtype=torch.float64) + 0.5) / width * 2.0 - 1.0
    v = (1.0 - (torch.arange(height, dtype=torch.float64) + 0.5) / height * 2.0) * height / width
    return torch.stack([u.expand(height, width), v[:, None].expand(height, width)])


def _log_radiance(parameters: Tensor, image: Tensor, distance: float) -> Tensor:
    """(3, h, w) log radiance of the uniform material at image coordinates."""
    albedo, f0 = parameters[:3].exp(), parameters[3].exp()
    roughness, intensity = torch.sigmoid(parameters[4]), parameters[5].exp()
    turn = rotation(parameters[8], parameters[9])
    # In the camera frame: points where the rays meet the tilted plane.
    normal = turn[:, 2]
    camera = torch.zeros(3, dtype=image.dtype)
    camera[2] = distance
    light = camera + torch.cat([parameters[6:8], torch.zeros(1, dtype=image.dtype)])
    ray = torch.cat([image, torch.full_like(image[:1], -distance)])
    along = -(normal[2] * distance) / torch.tensordot(normal, ray, dims=1)
    points = camera[:, None, None] + along * ray
    to_light = light[:, None, None] - points
    squared = dot(to_light, to_light)
    to_light, to_view = normalize(to_light), normalize(camera[:, None, None] - points)
    plane_normal = normal[:, None, None].expand_as(points)
    one = torch.ones_like(squared)
    reflectance = cook_torrance(
        albedo[:, None, None], f0 * one, roughness * one, plane_normal, to_light, to_view
    )
    falloff = dot(plane_normal, to_light).clamp_min(1e-3) / squared
    vignette = -parameters[10] * image.square().sum(0) / 1.25**2
    return torch.log(reflectance * falloff * intensity + 1e-12) + vignette


def _starts(observed: Tensor, centre: Tensor) -> Iterable[Tensor]:
    """Starting points whose brightness and hue already fit the photograph's median."""
    median = observed.flatten(1).median(dim=1).values
    hue = median - median.mean()
    for log_f0, logit_roughness, darker in _STARTS:
        start = centre.clone()
        start[:3] = centre[:3] + darker + hue
        start[3], start[4] = log_f0, logit_roughness
        # radiance = albedo / pi * intensity / distance^2, about; the prior says what splits it.
        start[5] = median.mean() - centre[0] - darker + math.log(math.pi) + 2.0
        yield start


def _levenberg_marquardt(
    residuals: Callable[[Tensor], Tensor], start: Tensor, prior: Tensor, precision: Tensor
) -> tuple[float, Tensor]:
    """Minimise Huber(residuals) plus a Gaussian prior; returns (cost, parameters)."""

    def cost_of(parameters: Tensor) -> float:
        r = residuals(parameters).abs()
        huber = torch.where(r < _HUBER, 0.5 * r.square(), _HUBER * (r - 0.5 * _HUBER)).sum()
        return float(huber + 0.5 * ((parameters - prior).square() * precision).sum())

    parameters, damping = start.clone(), 1e-2
    cost = cost_of(parameters)
    for _ in range(_ITERATIONS):
        r = residuals(parameters)
        jacobian = _jacobian(residuals, parameters)
        weight = _HUBER / r.abs().clamp_min(_HUBER)
        normal = (jacobian * weight[:, None]).T @ jacobian + torch.diag(precision)
        gradient = jacobian.T @ (weight * r) + precision * (parameters - prior)
        candidate, new = parameters, math.inf
        while not new < cost and damping < 1e6:
            damped = normal + damping * torch.diag(normal.diagonal())
            candidate = parameters - torch.linalg.solve(damped, gradient).clamp(-1.0, 1.0)
            new = cost_of(candidate)
            damping *= 4.0
        if not new < cost:
            break
        converged = cost - new < 1e-5 * cost
        parameters, cost, damping = candidate, new, max(damping / 16.0, 1e-6)
        if converged:
            break
    return cost, parameters


def _jacobian(residuals: Callable[[Tensor], Tensor], parameters: Tensor) -> Tensor:
    """(residuals, parameters) derivatives by central differences, right to 1e-8 in float64.

    Twice as fast as `torch.func.jacfwd` for so few parameters, and spares the two seconds in which
    that imports PyTorch's compiler.
    """
    steps = _STEP * torch.eye(len(parameters), dtype=parameters.dtype)
    moved = torch.vmap(residuals)(torch.cat([parameters + steps, parameters - steps]))
    forward, back = moved.chunk(2)
    return (forward - back).T / (2.0 * _STEP)
