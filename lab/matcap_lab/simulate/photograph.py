"""The flash photograph that a camera would take of a material whose maps are known.

The plane is shaded in float64 at several texels a pixel, warped by the tilt's homography and
area-averaged over pixels. files.py writes the files.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, plane_points, project, unproject
from matcap.flash.light import render_flash
from matcap.photo.photo import Photo

# (width, height, texel_size) to maps: a material and a seed.
Realise = Callable[[int, int, float], MapSet]
# (width, height, seed, texel_size) to maps: a material.
RealiseAt = Callable[[int, int, int, float], MapSet]

_ROWS = 64  # shaded at a time: float64 of a whole picture would take gigabytes
_HALF_FRAME = 18.0  # mm, half the long side of the 35 mm film frame


@dataclass(frozen=True)
class PhoneCamera:
    """A phone's camera."""

    width: int = 1600
    height: int = 1200
    """Pixels, width >= height, both even."""
    focal_length: int = 28
    """35 mm equivalent of the long side's field of view, mm."""
    full_well: float = 6000.0
    """Electrons at the clip level; sets the shot noise."""
    read_noise: float = 3.0
    """Electrons."""
    supersampling: int = 2
    """Shading texels along a pixel's side."""
    blur: float = 0.6
    """Standard deviation of the lens's blur, in pixels; positive."""
    brightness: float = 0.22
    """Mean that automatic exposure aims at; the clip level is 1."""
    clipped: float = 0.01
    """Largest share of pixels that automatic exposure allows to clip."""

    @property
    def fov(self) -> float:
        """Degrees across the long side."""
        return 2.0 * math.degrees(math.atan(_HALF_FRAME / self.focal_length))


@dataclass(frozen=True)
class Shot:
    """The image on the sensor, and its true camera and flash."""

    linear: NDArray[np.float64]
    """(H, W, 3) float64 radiance before noise and clipping; the file clips at 1."""
    setup: FlashSetup
    """The true geometry, and the flash's intensity on the scale of `linear`."""
    camera: PhoneCamera
    """The camera."""
    exposure: float = 1.0
    """Factor of the file's exposure relative to other shots."""
    fired: bool = True
    """Whether the flash fired."""


def take(realise: Realise, camera: PhoneCamera, setup: FlashSetup) -> Shot:
    """Photograph one realisation of a material; exposure is automatic.

    Of `setup`, offset, tilt and falloff count; field of view and intensity are set here.
    """
    setup = replace(setup, fov=camera.fov, intensity=(1.0, 1.0, 1.0))
    x, y, width, height = _view_rectangle(camera, setup)
    fine = camera.supersampling
    maps = realise(width * fine, height * fine, 2.0 / (camera.width * fine))
    extent = (camera.width * fine, camera.height * fine)
    shaded = _shade(maps, setup, (x * fine, y * fine), extent)
    picture = _projected(shaded, setup, (x * fine, y * fine), extent)
    blurred = cv2.GaussianBlur(picture, (0, 0), camera.blur * fine)
    size = (camera.width, camera.height)
    linear = np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float64)
    gain = sensor_exposure(linear, camera)
    return Shot(linear * gain, setup.with_intensity((gain, gain, gain)), camera)


def true_maps(realise: Realise, camera: PhoneCamera, setup: FlashSetup) -> MapSet:
    """Maps of the plane rectangle x in [-1, 1] of the same shot, one texel a pixel.

    Area means of the maps that were shaded: many materials give another realisation at another
    texel size.
    """
    x, y, width, height = _view_rectangle(camera, setup)
    fine = camera.supersampling
    maps = realise(width * fine, height * fine, 2.0 / (camera.width * fine))
    mean = torch.nn.functional.avg_pool2d(maps.stacked()[None], fine)[0]
    whole = MapSet.from_stacked(mean, 2.0 / camera.width)
    return whole.crop(-x, -y, camera.width, camera.height)


def expose(shot: Shot, seed: int) -> NDArray[np.float64]:
    """(H, W, 3) the picture with shot and read noise, clipped to [0, 1]."""
    return np.clip(sensor_noise(shot.linear, shot.camera, seed), 0.0, 1.0)


def sensor_noise(
    signal: NDArray[np.float64], camera: PhoneCamera, seed: int
) -> NDArray[np.float64]:
    """A signal of any shape with shot and read noise; 1 is the full well."""
    electrons = np.clip(signal, 0.0, 1.5) * camera.full_well
    deviation = np.sqrt(electrons + camera.read_noise**2) / camera.full_well
    return signal + deviation * np.random.default_rng(seed).standard_normal(signal.shape)


def as_photo(shot: Shot, seed: int, name: str) -> Photo:
    """The shot as if read from a RAW file."""
    pixels = expose(shot, seed).astype(np.float32)
    return Photo(
        pixels=pixels,
        clipped=np.asarray((pixels >= 1.0).any(axis=-1)),
        fov=shot.camera.fov,
        fov_source="exif",
        radiometric=True,
        name=name,
        original_size=(shot.camera.width, shot.camera.height),
        flash_fired=shot.fired,
        exposure=shot.exposure,
        balance=(1.0, 1.0, 1.0),
    )


def _view_rectangle(camera: PhoneCamera, setup: FlashSetup) -> tuple[int, int, int, int]:
    """Plane rectangle (x, y, width, height), pixels, that contains the view and the plane grid."""
    w, h = camera.width, camera.height
    sides = torch.tensor([[-1.0, 1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]], dtype=torch.float64)
    sides[1] *= h / w
    seen = unproject(sides, FlashSetup(fov=camera.fov, tilt=setup.tilt))[:2]
    reach_x = max(1.0, float(seen[0].abs().max())) * w / 2.0
    reach_y = max(h / w, float(seen[1].abs().max())) * w / 2.0
    margin_x, margin_y = math.ceil(reach_x - w / 2.0) + 2, math.ceil(reach_y - h / 2.0) + 2
    return -margin_x, -margin_y, w + 2 * margin_x, h + 2 * margin_y


def _shade(
    maps: MapSet, setup: FlashSetup, origin: tuple[int, int], extent: tuple[int, int]
) -> NDArray[np.float64]:
    """(h, w, 3) radiance of maps whose left top texel is `origin` of the picture's grid."""

    def shaded(strip: MapSet, first: int) -> Tensor:
        place = (origin[0], origin[1] + first)
        points = plane_points(*place, *strip.size, extent, dtype=maps.height.dtype)
        return render_flash(strip, setup, points)

    return np.ascontiguousarray(in_strips(maps, shaded).permute(1, 2, 0).numpy())


def in_strips(maps: MapSet, shaded: Callable[[MapSet, int], Tensor], rows: int = _ROWS) -> Tensor:
    """(C, H, W) of `shaded`(strip, first row), applied to strips of maps to save memory.

    Strips overlap by one row on either side, so that normals equal those of the whole.
    """
    width, height = maps.size
    strips = []
    for top in range(0, height, rows):
        first, last = max(0, top - 1), min(height, top + rows + 1)
        strip = shaded(maps.crop(0, first, width, last - first), first)
        strips.append(strip[:, top - first : min(height, top + rows) - first])
    return torch.cat(strips, dim=1)


def _projected(
    shaded: NDArray[np.float64], setup: FlashSetup, origin: tuple[int, int], extent: tuple[int, int]
) -> NDArray[np.float64]:
    """(H, W, 3) the plane's radiance as a tilted camera sees it, on a grid of `extent` texels."""
    width, height = extent
    # The homography of the plane, from four points of it.
    plane = torch.tensor(
        [[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]], dtype=torch.float64
    )
    image = project(plane, setup)

    def texels(u: Tensor, v: Tensor, x: int, y: int) -> NDArray[np.float32]:
        column = (u + 1.0) * width / 2.0 - 0.5 - x
        row = height / 2.0 - v * width / 2.0 - 0.5 - y
        return torch.stack([column, row], dim=-1).numpy().astype(np.float32)

    warp = cv2.getPerspectiveTransform(
        texels(plane[0], plane[1], *origin), texels(image[0], image[1], 0, 0)
    )
    return np.asarray(
        cv2.warpPerspective(
            shaded, warp, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    )


def sensor_exposure(linear: NDArray[np.float64], camera: PhoneCamera) -> float:
    """Gain that brings the mean to the camera's brightness, or the brightest pixels to 1."""
    brightest = float(np.quantile(linear.max(axis=-1), 1.0 - camera.clipped))
    return min(camera.brightness / float(linear.mean()), 1.0 / brightest)


# Random framing, and a phone's sensor and processing: exposure, noise, tone curve, gradients.
#
# Used for training photographs (inverse/samples.py, train/alignment.py).


def random_crop(maps: MapSet, width: int, height: int, rng: np.random.Generator) -> MapSet:
    """A crop of maps anywhere in them."""
    across, down = maps.size
    x, y = rng.integers(across - width + 1), rng.integers(down - height + 1)
    return maps.crop(int(x), int(y), width, height)


def exposure(radiance: Tensor, rng: np.random.Generator) -> float:
    """Random gain of radiance (3, H, W): mean at most 0.15 to 0.4, 0 to 4 % of pixels above 1."""
    share = rng.choice([0.0, 0.002, 0.01, 0.04], p=[0.4, 0.3, 0.2, 0.1])  # that is clipped
    bright = float(torch.quantile(radiance.amax(0)[::2, ::2].flatten(), 1.0 - share))
    gain = min(rng.uniform(0.15, 0.4) / float(radiance.mean()), rng.uniform(0.7, 1.0) / bright)
    return max(gain, 1.0 / bright) if share else gain


def contrast(linear: Tensor, power: float) -> Tensor:
    """Contrast as a power law about the median m: m (x / m)^power."""
    middle = float(linear.median().clamp_min(1e-4))
    return middle * (linear / middle).clamp_min(1e-4) ** power


def drift(
    height: int, width: int, rng: np.random.Generator, even: float, coloured: float
) -> Tensor:
    """(3, H, W) smooth random gain that varies in brightness and colour across the picture.

    Args:
        height, width: pixels.
        rng: random numbers.
        even, coloured: standard deviations of log gain, common to and independent by channel.
    """
    coarse = np.exp(rng.normal(0.0, even, (2, 3, 1)) + rng.normal(0.0, coloured, (2, 3, 3)))
    smooth = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    return torch.from_numpy(smooth).permute(2, 0, 1)


def shoulder(linear: Tensor, bend: float) -> Tensor:
    """Highlight roll-off x (1 + bend) / (1 + bend x) below 1; values above are unchanged."""
    return torch.where(linear < 1.0, linear * (1.0 + bend) / (1.0 + bend * linear), linear)


def noisy(linear: Tensor, level: float, rng: np.random.Generator) -> Tensor:
    """Add shot and read noise and clip to [0, 1]; level 1 is a small sensor in dim light."""
    noise = torch.from_numpy(rng.standard_normal(tuple(linear.shape)).astype(np.float32))
    deviation = (linear.clamp_min(0.0) * (0.03 * level) ** 2 + (0.004 * level) ** 2).sqrt()
    return (linear + deviation * noise).clamp(0.0, 1.0)
