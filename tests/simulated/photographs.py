"""Flash photographs of materials whose maps are known, rendered by the product's own formulas.

A piece of material is a function (width, height, texel size) -> MapSet around the origin of the
plane. `take` photographs it by one FlashSetup; `take_several` by a phone that a hand moves, with
parallax of the relief. Radiance is shaded on the plane's texels and resampled by the camera's rays.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, grid_points
from matcap.flash.geometry import OWN, Extent, FlashSetup, plane_points, unproject
from matcap.flash.light import CORNER_SQUARED, render_flash, shade
from matcap.photo.photo import Photo

Piece = Callable[[int, int, float], MapSet]


@dataclass(frozen=True)
class PhoneCamera:
    """A phone's camera; brightness is the mean that automatic exposure aims at."""

    width: int = 1600
    height: int = 1200
    focal_length: int = 28  # 35 mm equivalent of the long side
    supersampling: int = 2  # texels along a pixel's side
    blur: float = 0.6  # pixels
    brightness: float = 0.22
    clipped: float = 0.01  # largest share of clipped pixels
    full_well: float = 6000.0  # electrons at the clip level
    read_noise: float = 3.0  # electrons

    @property
    def fov(self) -> float:
        """Degrees across the long side."""
        return 2.0 * math.degrees(math.atan(18.0 / self.focal_length))


@dataclass(frozen=True)
class Shot:
    """(H, W, 3) radiance before noise and clipping at 1, with its true camera and flash."""

    linear: NDArray[np.float64]
    setup: FlashSetup
    camera: PhoneCamera
    exposure: float = 1.0
    fired: bool = True


def take(piece: Piece, camera: PhoneCamera, setup: FlashSetup) -> Shot:
    """Photograph a piece; the camera sets field of view and intensity, exposure is automatic."""
    setup = replace(setup, fov=camera.fov, intensity=(1.0, 1.0, 1.0))
    points = unproject(torch.from_numpy(_image(camera)), setup)[:2].numpy()
    maps = _around(piece, camera, points)
    width, height = maps.size
    extent = (camera.width * camera.supersampling, camera.height * camera.supersampling)
    corner = ((extent[0] - width) // 2, (extent[1] - height) // 2)
    place = plane_points(*corner, width, height, extent, dtype=maps.height.dtype)
    radiance = render_flash(maps, setup, place).permute(1, 2, 0).float().numpy()
    linear = _pixels(_bilinear(np.ascontiguousarray(radiance), points, maps.texel_size), camera)
    gain = _exposure(linear, camera)
    return Shot(linear * gain, setup.with_intensity((gain, gain, gain)), camera)


def true_maps(piece: Piece, camera: PhoneCamera) -> MapSet:
    """Maps of the plane rectangle x in [-1, 1], one texel a pixel: means of what is shaded."""
    fine = camera.supersampling
    maps = piece(camera.width * fine, camera.height * fine, 2.0 / (camera.width * fine))
    mean = torch.nn.functional.avg_pool2d(maps.stacked()[None], fine)[0]
    return MapSet.from_stacked(mean, 2.0 / camera.width)


def noisy(signal: NDArray[np.float64], camera: PhoneCamera, seed: int) -> NDArray[np.float64]:
    """A signal of any shape with shot and read noise, clipped to [0, 1]."""
    electrons = np.clip(signal, 0.0, 1.5) * camera.full_well
    deviation = np.sqrt(electrons + camera.read_noise**2) / camera.full_well
    drawn = np.random.default_rng(seed).standard_normal(signal.shape)
    return np.clip(signal + deviation * drawn, 0.0, 1.0)


def as_photo(shot: Shot, seed: int, name: str) -> Photo:
    """The shot as if read from a RAW file."""
    pixels = noisy(shot.linear, shot.camera, seed).astype(np.float32)
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


@dataclass(frozen=True)
class Hand:
    """How a phone moves between photographs: see `hold`. `flash` is its offset, plane units."""

    aside: float = 0.35  # sideways, over the distance
    aimed: float = 0.25  # 0 looks at the middle, 1 straight down
    shaken: float = 0.03  # deviation of the position, over the distance
    turned: float = 0.03  # deviation of the direction, radians
    flash: tuple[float, float, float] = (0.04, -0.07, 0.0)
    bent: tuple[float, float] = (0.0, 0.0)  # distortion of the lens
    balanced: float = 0.03  # deviation of log white balance
    vignetting: float = 0.0
    room: float = 0.0  # irradiance of ambient light on a level surface, flash of intensity 1


def hold(phone: PhoneCamera, hand: Hand, count: int, seed: int) -> list[PosedCamera]:
    """Random poses: the first above the middle, the others moved aside in turn by 90 degrees."""
    rng = np.random.default_rng(seed)
    distance = 1.0 / math.tan(math.radians(phone.fov) / 2.0)
    tilt = rng.normal(0.0, 0.02, 2)
    first = FlashSetup(fov=phone.fov, tilt=(float(tilt[0]), float(tilt[1])))
    cameras = [PosedCamera.of(first, hand.bent)]
    for number in range(1, count):
        ring, turn = (1.0, 0.0) if number <= 4 else (0.6, math.pi / 4.0)
        angle = (number - 1) * math.pi / 2.0 + turn
        aside = ring * hand.aside * np.array([math.cos(angle), math.sin(angle), 0.0])
        place = distance * (np.array([0.0, 0.0, 1.0]) + aside + rng.normal(0.0, hand.shaken, 3))
        aim = np.append(distance * rng.normal(0.0, hand.turned, 2) + hand.aimed * place[:2], 0.0)
        roll = rng.normal(0.0, 2.0 * hand.turned)
        cameras.append(PosedCamera(_look_at(place, aim, roll), place, Lens(distance, hand.bent)))
    return cameras


def take_several(
    piece: Piece, phone: PhoneCamera, cameras: Sequence[PosedCamera], hand: Hand, seed: int = 0
) -> list[Shot]:
    """Photograph one piece from several places; `seed` is of the white balances."""
    rng = np.random.default_rng(seed)
    maps = _seen_by_all(piece, phone, cameras)
    width, height = maps.size
    place = plane_points(0, 0, width, height, (width, height), dtype=torch.float64)
    place = torch.cat([place[:2] * width * maps.texel_size / 2.0, maps.height.double()])
    shots = []
    for camera in cameras:
        balance = np.exp(rng.normal(0.0, hand.balanced, 3))
        light, eye = torch.from_numpy(camera.flash(hand.flash)), torch.from_numpy(camera.place)
        shaded = shade(maps, place, eye, light, torch.ones(3)).float()
        radiance = shaded.permute(1, 2, 0).numpy() + _ambient(maps, hand.room)
        linear = _by_camera(radiance, maps, camera, phone, hand.vignetting) * balance
        gain = _exposure(linear, phone)
        red, green, blue = (float(v) for v in gain * balance)
        setup = FlashSetup(
            fov=phone.fov, offset=hand.flash, vignetting=hand.vignetting
        ).with_intensity((red, green, blue))
        shots.append(Shot(linear * gain, setup, phone, exposure=gain))
    return shots


def take_without_flash(
    piece: Piece, phone: PhoneCamera, cameras: Sequence[PosedCamera], hand: Hand, seed: int = 0
) -> tuple[Shot, PosedCamera]:
    """The same piece by the room's light alone, from near the first place, and that camera."""
    rng = np.random.default_rng(seed)
    first = cameras[0]
    place = first.place + hand.shaken * first.place[2] * rng.normal(0.0, 1.0, 3)
    camera, maps = replace(first, place=place), _seen_by_all(piece, phone, cameras)
    balance = np.exp(rng.normal(0.0, hand.balanced, 3))
    ambient = _ambient(maps, hand.room)
    linear = _by_camera(ambient, maps, camera, phone, hand.vignetting) * balance
    gain = _exposure(linear, phone)
    return Shot(linear * gain, FlashSetup(fov=phone.fov), phone, gain, fired=False), camera


def true_maps_along(
    piece: Piece,
    phone: PhoneCamera,
    cameras: Sequence[PosedCamera],
    number: int,
    estimated: PosedCamera,
    size: tuple[int, int],
    extent: Extent = OWN,
) -> MapSet:
    """True maps along camera `number`'s rays, for texels resampled by an estimated camera.

    An error of the estimated pose displaces texels; the truth is looked up where the ray of each
    texel's pixel meets the relief. `size` is the extent's (columns, rows).
    """
    maps, true, texel = _seen_by_all(piece, phone, cameras), cameras[number], extent.texel(size[0])
    blur = 0.4 * texel / maps.texel_size
    stacked = cv2.GaussianBlur(
        np.ascontiguousarray(maps.stacked().float().permute(1, 2, 0).numpy()), (0, 0), blur
    )
    points = _on_relief(true.on_plane(estimated.sees(grid_points(*size, extent))), true, maps)
    seen = _bilinear(stacked, points, maps.texel_size)
    return MapSet.from_stacked(torch.from_numpy(seen).permute(2, 0, 1).contiguous(), texel)


def relative_position(first: PosedCamera, camera: PosedCamera) -> Doubles:
    """(3,) position of a camera in the first one's frame."""
    return np.asarray(first.turn @ (camera.place - first.place))


def _ambient(maps: MapSet, level: float) -> NDArray[np.float32]:
    """(H, W, 3) radiance by an even sky and a window of the same irradiance."""
    towards = torch.tensor([0.6, 0.3, 0.75], dtype=torch.float64)
    towards = towards / towards.norm()
    normal = maps.normal.double()
    facing = (normal * towards[:, None, None]).sum(0).clamp_min(0.0) / towards[2]
    arrives = 0.25 * (1.0 + normal[2]) + 0.5 * facing
    colour = torch.tensor([1.1, 1.0, 0.85], dtype=torch.float64)[:, None, None]
    lit = level / math.pi * colour * (maps.diffuse.double() * arrives + maps.specular.double())
    return np.asarray(lit.float().permute(1, 2, 0).numpy())


def _image(phone: PhoneCamera) -> Doubles:
    """(2, H, W) image coordinates of the subpixels' centres, x in [-1, 1], y up."""
    width, height = phone.width * phone.supersampling, phone.height * phone.supersampling
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([columns - width / 2.0, height / 2.0 - rows]) * 2.0 / width


def _around(piece: Piece, phone: PhoneCamera, points: Doubles) -> MapSet:
    """Maps of a rectangle around the origin that contains points of the plane, texels even."""
    texel = 2.0 / (phone.width * phone.supersampling)
    reach = [1.02 * max(float(np.abs(axis).max()), texel) for axis in points[:2]]
    width, height = (2 * math.ceil(side / texel) for side in reach)
    return piece(width, height, texel)


def _seen_by_all(piece: Piece, phone: PhoneCamera, cameras: Sequence[PosedCamera]) -> MapSet:
    up = phone.height / phone.width
    corners = np.array([[-1.0, 1.0, -1.0, 1.0], [up, up, -up, -up]])
    return _around(piece, phone, np.concatenate([c.on_plane(corners) for c in cameras], axis=1))


def _by_camera(
    radiance: NDArray[np.float32],
    maps: MapSet,
    camera: PosedCamera,
    phone: PhoneCamera,
    vignetting: float,
) -> Doubles:
    """(H, W, 3) picture of maps of a given radiance, with parallax."""
    image = _image(phone)
    points = _on_relief(camera.on_plane(image), camera, maps)
    seen = _bilinear(np.ascontiguousarray(radiance), points, maps.texel_size)
    lost = np.exp(-vignetting * np.square(image).sum(0) / CORNER_SQUARED)
    return _pixels(seen * lost[..., None], phone)


def _on_relief(points: Doubles, camera: PosedCamera, maps: MapSet) -> Doubles:
    """(3, H, W) where rays from a camera to points of the plane meet the relief."""
    start, height = camera.place[:, None, None], maps.height[0].float().numpy()
    ray = points - start
    for _ in range(3):  # slopes are below 1 nearly everywhere
        level = _bilinear(height, points, maps.texel_size)
        points = start + (level - camera.place[2]) / ray[2] * ray
    return points


def _bilinear(channels: NDArray[np.float32], points: Doubles, texel: float) -> NDArray[np.float32]:
    """Values of channels (h, w) or (h, w, C) around the origin at points (2 or 3, H, W)."""
    height, width = channels.shape[:2]
    x, y = points[0] / texel + width / 2.0 - 0.5, height / 2.0 - 0.5 - points[1] / texel
    places = x.astype(np.float32), y.astype(np.float32)
    flags, border = cv2.INTER_LINEAR, cv2.BORDER_REFLECT
    if channels.ndim == 2 or channels.shape[2] <= 4:
        return np.asarray(cv2.remap(channels, *places, flags, borderMode=border))
    split = [cv2.remap(one, *places, flags, borderMode=border) for one in cv2.split(channels)]
    return np.stack(split, axis=-1)


def _pixels(seen: NDArray[np.float32], phone: PhoneCamera) -> Doubles:
    """Blur by the lens, and means over pixels."""
    blurred = cv2.GaussianBlur(seen, (0, 0), phone.blur * phone.supersampling)
    size = (phone.width, phone.height)
    return np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float64)


def _exposure(linear: Doubles, phone: PhoneCamera) -> float:
    """Gain that brings the mean to the camera's brightness, or the brightest pixels to 1."""
    brightest = float(np.quantile(linear.max(axis=-1), 1.0 - phone.clipped))
    return min(phone.brightness / float(linear.mean()), 1.0 / brightest)


def _look_at(place: Doubles, aim: Doubles, roll: float) -> Doubles:
    """(3, 3) rotation of a camera at a place that looks at a point."""
    back = (place - aim) / np.linalg.norm(place - aim)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    c, s = math.cos(roll), math.sin(roll)
    return np.asarray(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ axes)
