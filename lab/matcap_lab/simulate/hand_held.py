"""Simulated hand-held photographs of one sample from several poses, the flash moving along.

The plane's frame is the first camera's. Relief has parallax: rays are intersected with the height
map, not with the plane. Distances, tilts, exposures and white balances are random.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.registration.camera import Lens, PosedCamera, grid_points
from matcap.flash.geometry import OWN, Extent, FlashSetup
from matcap.flash.light import CORNER_SQUARED, shade
from matcap_lab.simulate.files import PHONE, write_gain_map_jpeg, write_jpeg
from matcap_lab.simulate.photograph import (
    PhoneCamera,
    Realise,
    RealiseAt,
    Shot,
    in_strips,
    sensor_exposure,
)
from matcap_lab.simulate.specimen import Specimen

Doubles = NDArray[np.float64]

_AZIMUTHS = [(math.cos(k * math.pi / 4.0), math.sin(k * math.pi / 4.0)) for k in range(8)]
_FARTHEST = 150.0  # texels: relief farther away hides hardly any sky
_ITERATIONS = 3  # iterations of ray-relief intersection; slopes are below 1 nearly everywhere


@dataclass(frozen=True)
class Room:
    """Ambient light: a uniform sky and a directional window."""

    level: float = 0.06
    """Irradiance of a horizontal surface, for a flash of intensity 1."""
    window: float = 0.5
    """Share of `level` from the window."""
    towards: tuple[float, float, float] = (0.6, 0.3, 0.75)
    """Direction of the window, any length."""
    colour: tuple[float, float, float] = (1.1, 1.0, 0.85)
    """RGB factors of the light."""
    uneven: float = 0.0
    """Gradient of log irradiance towards the window, per plane unit."""
    hidden: bool = False
    """Whether the relief occludes the sky (ambient occlusion)."""

    def on(self, maps: MapSet) -> NDArray[np.float32]:
        """(H, W, 3) view-independent radiance E0 / pi (albedo E / E0 + F0), E0 the level.

        F0 reflects surroundings of the sky's radiance.
        """
        towards = torch.tensor(self.towards, dtype=torch.float64)
        towards = towards / towards.norm()
        normal = maps.normal.double()
        facing = (normal * towards[:, None, None]).sum(0).clamp_min(0.0) / towards[2]
        sky = _sky_view_factor(maps) if self.hidden else 0.5 * (1.0 + normal[2])
        arrives = (1.0 - self.window) * sky + self.window * facing
        if self.uneven:
            arrives = arrives * (self.uneven * _along(maps, towards)).exp()
        even = maps.diffuse.double() * arrives + maps.specular.double()
        colour = torch.tensor(self.colour, dtype=torch.float64)[:, None, None]
        lit = self.level / math.pi * colour * even
        return np.ascontiguousarray(lit.float().permute(1, 2, 0).numpy())


def _along(maps: MapSet, towards: Tensor) -> Tensor:
    """(H, W) coordinate along a horizontal direction from the middle of maps, plane units."""
    width, height = maps.size
    flat = towards[:2] / towards[:2].norm().clamp_min(1e-9)
    x = (torch.arange(width, dtype=torch.float64) - 0.5 * (width - 1)) * maps.texel_size
    y = (0.5 * (height - 1) - torch.arange(height, dtype=torch.float64)) * maps.texel_size
    return flat[0] * x + flat[1] * y[:, None]


def _sky_view_factor(maps: MapSet) -> Tensor:
    """(H, W) share of a uniform sky's irradiance above the relief's horizons [max1988].

    The mean over eight azimuths of cos^2 of the horizon's elevation, which is sampled at distances
    growing by a factor of 1.5.
    """
    height = (maps.height[0] / maps.texel_size).float()
    share = torch.zeros_like(height)
    for x, y in _AZIMUTHS:
        horizon, far = torch.zeros_like(height), 1.0
        while far < _FARTHEST:
            dx, dy = round(far * x), round(far * y)
            there = torch.roll(height, (-dy, -dx), (0, 1)) - height
            horizon = torch.maximum(horizon, there / math.hypot(dx, dy))
            far = max(far + 1.0, 1.5 * far)
        share += 1.0 / (1.0 + horizon.square())  # cos^2 of its elevation
    return share.double() / len(_AZIMUTHS)


@dataclass(frozen=True)
class Hand:
    """Movements and lighting of a phone between hand-held photographs."""

    aside: float = 0.35
    """Sideways movement, relative to the distance."""
    aimed: float = 0.25
    """Movement of the point aimed at, relative to the phone's: 0 keeps aiming at the middle, 1
    looks straight down."""
    shaken: float = 0.03
    """Standard deviation of the position, relative to the distance."""
    turned: float = 0.03
    """Standard deviation of the viewing direction, radians."""
    flash: tuple[float, float, float] = (0.04, -0.07, 0.0)
    """Offset of the flash from the lens, plane units."""
    bent: tuple[float, float] = (0.0, 0.0)
    """(k1, k2) of the lens distortion."""
    balanced: float = 0.03
    """Standard deviation of the logarithm of white balance, by channel."""
    vignetting: float = 0.0
    """Coefficient of r^2, of lens and flash."""
    room: Room | None = None
    """Ambient light; None for darkness."""


def downward(phone: PhoneCamera) -> Hand:
    """A Hand that moves by half a picture each time and looks straight down."""
    return Hand(aside=math.tan(math.radians(phone.fov) / 2.0), aimed=1.0)


def hold(phone: PhoneCamera, hand: Hand, count: int, seed: int) -> list[PosedCamera]:
    """Random poses: the first above the middle, the others moved sideways; see Hand."""
    rng = np.random.default_rng(seed)
    distance = 1.0 / math.tan(math.radians(phone.fov) / 2.0)
    tilt = rng.normal(0.0, 0.02, 2)
    cameras = [
        PosedCamera.of(FlashSetup(fov=phone.fov, tilt=(float(tilt[0]), float(tilt[1]))), hand.bent)
    ]
    for number in range(1, count):
        ring = 1.0 if number <= 4 else 0.6
        angle = (number - 1) * math.pi / 2.0 + (0.0 if number <= 4 else math.pi / 4.0)
        aside = ring * hand.aside * np.array([math.cos(angle), math.sin(angle), 0.0])
        place = distance * (np.array([0.0, 0.0, 1.0]) + aside + rng.normal(0.0, hand.shaken, 3))
        aim = np.append(distance * rng.normal(0.0, hand.turned, 2) + hand.aimed * place[:2], 0.0)
        roll = rng.normal(0.0, 2.0 * hand.turned)
        cameras.append(PosedCamera(_look_at(place, aim, roll), place, Lens(distance, hand.bent)))
    return cameras


def take_several(
    realise: Realise,
    phone: PhoneCamera,
    cameras: Sequence[PosedCamera],
    hand: Hand,
    seed: int = 0,
) -> list[Shot]:
    """Photograph one piece from several places; every exposure is automatic.

    `hand` has flash, lens and ambient light; `seed` is of the white balances. Only the first one's
    setup has its camera's tilt.
    """
    rng = np.random.default_rng(seed)
    maps = _piece(realise, phone, cameras)
    room = None if hand.room is None else hand.room.on(maps)
    shots = []
    for camera in cameras:
        balance = np.exp(rng.normal(0.0, hand.balanced, 3))
        radiance = _shaded(maps, camera, hand)
        radiance = radiance if room is None else radiance + room
        linear = _picture(maps, radiance, camera, phone, hand) * balance
        gain = sensor_exposure(linear, phone)
        setup = FlashSetup(
            fov=phone.fov,
            offset=hand.flash,
            intensity=tuple(float(v) for v in gain * balance),  # type: ignore[arg-type]
            vignetting=hand.vignetting,
        )
        shots.append(Shot(linear * gain, setup, phone, exposure=gain))
    turn = cameras[0].turn  # of PosedCamera.of: R = Ry(tilt_y) Rx(tilt_x)
    tilt = np.arctan2(-turn[1, 2], turn[1, 1]), np.arctan2(-turn[2, 0], turn[0, 0])
    tilted = replace(shots[0].setup, tilt=(float(tilt[0]), float(tilt[1])))
    return [replace(shots[0], setup=tilted), *shots[1:]]


def take_without_flash(
    realise: Realise,
    phone: PhoneCamera,
    cameras: Sequence[PosedCamera],
    hand: Hand,
    seed: int = 0,
) -> tuple[Shot, PosedCamera]:
    """Photograph the same sample by the light of `hand.room` alone, near the first pose.

    `seed` is of white balance and pose. Returns the photograph and its true pose.
    """
    rng = np.random.default_rng(seed)
    first = cameras[0]
    place = first.place + hand.shaken * first.place[2] * rng.normal(0.0, 1.0, 3)
    camera = replace(first, place=place)
    maps = _piece(realise, phone, cameras)  # the very piece of take_several
    balance = np.exp(rng.normal(0.0, hand.balanced, 3))
    linear = _picture(maps, (hand.room or Room()).on(maps), camera, phone, hand) * balance
    gain = sensor_exposure(linear, phone)
    setup = FlashSetup(fov=phone.fov)
    return Shot(linear * gain, setup, phone, exposure=gain, fired=False), camera


def true_maps_along(
    realise: Realise,
    phone: PhoneCamera,
    cameras: Sequence[PosedCamera],
    number: int,
    estimated: PosedCamera,
    size: tuple[int, int],
    extent: Extent = OWN,
) -> MapSet:
    """True maps along the rays of camera `number`, for texels resampled from its photograph alone.

    Errors of the estimated pose displace the plane's texels; the truth is therefore looked up along
    the ray of the pixel that each texel was resampled from. `size` is the extent's (columns, rows).
    """
    maps, true, texel = _piece(realise, phone, cameras), cameras[number], extent.texel(size[0])
    blur = 0.4 * texel / maps.texel_size
    stacked = [
        np.asarray(cv2.GaussianBlur(channel, (0, 0), blur), np.float32)
        for channel in maps.stacked().float().numpy()
    ]
    points = true.on_plane(estimated.sees(grid_points(*size, extent)))
    bilinear = partial(_bilinear, texel=maps.texel_size, border=cv2.BORDER_REFLECT)
    points = _intersections(points, true.place, partial(bilinear, stacked[-1]))
    planes = np.stack([bilinear(channel, points) for channel in stacked])
    return MapSet.from_stacked(torch.from_numpy(planes), texel)


def _piece(realise: Realise, phone: PhoneCamera, cameras: Sequence[PosedCamera]) -> MapSet:
    """Maps of a square around the origin that contains the views of all cameras."""
    reach = max(_reach(camera, phone) for camera in cameras)
    side = 2 * math.ceil(reach * phone.width * phone.supersampling / 2.0)
    return realise(side, side, 2.0 / (phone.width * phone.supersampling))


def _picture(
    maps: MapSet,
    radiance: NDArray[np.float32],
    camera: PosedCamera,
    phone: PhoneCamera,
    hand: Hand,
) -> Doubles:
    """(H, W, 3) picture of maps of a given radiance, with parallax, vignetting and blur."""
    fine = phone.supersampling
    size = (phone.width * fine, phone.height * fine)
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    half = size[0] / 2.0
    image = np.stack([columns - half, size[1] / 2.0 - rows]) / half
    points = camera.on_plane(image)
    height, texel = maps.height[0].numpy().astype(np.float32), maps.texel_size
    points = _intersections(points, camera.place, partial(_bilinear, height, texel=texel))
    seen = _bilinear(radiance, points, texel=texel, border=cv2.BORDER_REFLECT)
    squared = np.square(image).sum(0) / CORNER_SQUARED
    seen = seen * np.exp(-hand.vignetting * squared)[..., None]
    blurred = cv2.GaussianBlur(seen, (0, 0), phone.blur * fine)
    shrunk = cv2.resize(blurred, (phone.width, phone.height), interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, np.float64)


def _bilinear(
    channel: NDArray[np.float32],
    points: Doubles,
    *,
    texel: float,
    border: int = cv2.BORDER_CONSTANT,
) -> NDArray[np.float32]:
    """(H, W) bilinear values of a square channel around the origin at points (2 or 3, H, W)."""
    side = channel.shape[0]
    x, y = points[0] / texel + side / 2.0 - 0.5, side / 2.0 - 0.5 - points[1] / texel
    places = x.astype(np.float32), y.astype(np.float32)
    return np.asarray(cv2.remap(channel, *places, cv2.INTER_LINEAR, borderMode=border), np.float32)


def _intersections(
    points: Doubles, eye: Doubles, height: Callable[[Doubles], NDArray[np.float32]]
) -> Doubles:
    """(3, H, W) intersections of rays from an eye to points of the plane with the relief."""
    start = eye[:, None, None]
    ray = points - start
    for _ in range(_ITERATIONS):
        points = start + (height(points) - eye[2]) / ray[2] * ray
    return points


def _shaded(maps: MapSet, camera: PosedCamera, hand: Hand) -> NDArray[np.float32]:
    """(H, W, 3) radiance of the whole plane towards a camera."""
    width, height = maps.size
    texel = maps.texel_size
    light, eye = torch.from_numpy(camera.flash(hand.flash)), torch.from_numpy(camera.place)

    def shaded(strip: MapSet, first: int) -> Tensor:
        rows = strip.size[1]
        x = (torch.arange(width, dtype=torch.float64) + 0.5 - width / 2.0) * texel
        y = (height / 2.0 - torch.arange(first, first + rows, dtype=torch.float64) - 0.5) * texel
        points = [x.expand(rows, -1), y[:, None].expand(-1, width), strip.height[0].double()]
        return shade(strip, torch.stack(points), eye, light, torch.ones(3)).float()

    return np.ascontiguousarray(in_strips(maps, shaded).permute(1, 2, 0).numpy())


def _reach(camera: PosedCamera, phone: PhoneCamera) -> float:
    """Half the side of the square around the origin that contains a camera's view, plane units."""
    up = phone.height / phone.width
    corners = camera.on_plane(np.array([[-1.0, 1.0, -1.0, 1.0], [up, up, -up, -up]]))
    return 1.05 * float(np.abs(corners[:2]).max())


def _look_at(place: Doubles, aim: Doubles, roll: float) -> Doubles:
    """(3, 3) rotation of a camera at a place that looks at a point."""
    back = (place - aim) / np.linalg.norm(place - aim)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    c, s = math.cos(roll), math.sin(roll)
    return np.asarray(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ axes)


# Distributions of phone photographs: exposure, clipping, tilt, flash and distance.
#
# Fitted to every third of 126 phone photographs of flat samples under their own flash (2026-11-24)
# at 512 texels. Mean linear radiance: 5th and 95th percentiles 0.07 and 0.21; median 0.133,
# standard deviation of the logarithm 0.35. Clipped pixels: none at the median, 0.05 % at the 75th
# percentile, 1 % at the 95th. Coarse fits: tilts of deviation 2.0 and 1.7 degrees, a flash 0.08
# plane units above the lens. No file states its distance: 20 to 40 cm, as the guide asks for.

_BRIGHTNESS = (0.133, 0.35)  # of the clip level: median, and deviation of the logarithm
_CLIPPED = ((0.0, 0.5, 0.75, 0.95, 1.0), (0.0, 0.0, 5e-4, 0.01, 0.02))  # shares, by quantile
_TILT = 0.032  # radians: deviation about either axis
_FLASH = ((0.01, 0.04), (0.08, 0.045))  # plane units: mean and deviation, across and up
_DISTANCE = math.log(2.0) / 2.0  # 20 to 40 cm, about their geometric mean
FORMS = ("DNG", "JPEG", "JPEG, two exposures", "JPEG, gain map")
_DRAWN = 42  # seed of the draws, together with a material's name


@dataclass(frozen=True)
class PhonePhotographs:
    """A material, scaled for the distance, and how it is photographed.

    The phone has its exposure; `tilt` is the first photograph's, radians.
    """

    specimen: Specimen
    phone: PhoneCamera
    hand: Hand
    tilt: tuple[float, float]

    @staticmethod
    def of(specimen: Specimen, phone: PhoneCamera) -> PhonePhotographs:
        """Draw how a specimen is photographed; the draw depends on its name alone."""
        rng = np.random.default_rng([zlib.crc32(specimen.name.encode()), _DRAWN])
        brightness = _BRIGHTNESS[0] * math.exp(rng.normal(0.0, _BRIGHTNESS[1]))
        clipped = float(np.interp(rng.random(), *_CLIPPED))
        tilt_x, tilt_y = np.clip(rng.normal(0.0, _TILT, 2), -3.0 * _TILT, 3.0 * _TILT).tolist()
        x, y = (rng.normal(*each) for each in _FLASH)
        further = math.exp(rng.uniform(-_DISTANCE, _DISTANCE))
        return PhonePhotographs(
            replace(specimen, material=partial(_from_further, specimen.material, further)),
            replace(phone, brightness=brightness, clipped=clipped),
            Hand(flash=(x, y, 0.0)),
            (tilt_x, tilt_y),
        )

    def take(self, count: int, out: Path) -> tuple[dict[str, list[Path]], FlashSetup]:
        """Files by form, one of FORMS, and the first one's true setup; not taken twice.

        `count` DNGs; and the first photograph as a JPEG, as two of which the second is two stops
        darker, and as one with an HDR gain map.

        Raises:
            MatcapError: the folder cannot be written.
        """
        subject = self.specimen
        raw = [subject.path(out, number) for number in range(count)]
        bright, dark, above = (out / f"{name}.jpg" for name in ("bright", "dark", "gain_map"))
        sidecar = out / "setup.json"
        if not all(path.exists() for path in (sidecar, *raw, bright, dark, above)):
            cameras = hold(self.phone, self.hand, count, subject.seed)
            first = FlashSetup(fov=self.phone.fov, tilt=self.tilt)
            cameras[0] = PosedCamera.of(first, self.hand.bent)
            shots = take_several(subject.realise, self.phone, cameras, self.hand, subject.seed)
            for number, shot in enumerate(shots):
                subject.write(shot, out, number)
            write_jpeg(bright, shots[0], subject.seed, PHONE)
            write_gain_map_jpeg(above, shots[0], subject.seed)
            less = replace(shots[0], linear=shots[0].linear / 4, exposure=shots[0].exposure / 4)
            write_jpeg(dark, less, subject.seed + 1, PHONE)
            sidecar.write_text(json.dumps({"intensity": shots[0].setup.intensity}))
        red, green, blue = json.loads(sidecar.read_text())["intensity"]
        setup = FlashSetup(fov=self.phone.fov, offset=self.hand.flash, tilt=self.tilt)
        files = dict(zip(FORMS, (raw, [bright], [bright, dark], [above]), strict=True))
        return files, setup.with_intensity((red, green, blue))


def _from_further(
    material: RealiseAt, factor: float, width: int, height: int, seed: int, texel_size: float
) -> MapSet:
    """A realisation seen from `factor` times the distance, so scaled down by `factor`."""
    maps = material(width, height, seed, factor * texel_size)
    return replace(maps, height=maps.height / factor, texel_size=texel_size)
