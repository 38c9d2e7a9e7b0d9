"""The alignment branch: tilt of the plane from a photograph, or from convergence of its spectra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.tensors import StoredTensors, write_tensors
from matcap.flash.coarse.problem import TiltPrior
from matcap.photo.photo import Photo

# Tilt from perspective: how the local spectra of a texture change across the picture.
#
# The point p of the picture of a tilted plane shows the plane's point X = p (1 - t p), to first
# order in the slopes t = (t_x, t_y), the tangents of its tilt over the camera's distance. A
# stationary texture of spectrum S has at p the spectrum S(k + (t p) k + t (p k)) [malik1997], and
#
# log S_p - log S = grad log S . ((t p) k + t (p k)),
#
# linear in t: least squares over the periodograms of overlapping windows, repeated on the picture
# warped by the estimate. Free in each window is the energy of every octave, as the flash changes
# it. Relief under a flash has more energy along the direction of the light, too: the second
# estimate leaves local orientation free.

ESTIMATES = 2
_COLUMNS = (256, 1024)  # columns of the picture that is read, at least and at most
_WINDOWS = 8  # windows across the picture, beside each other; they overlap by half
_LONGEST, _SHORTEST = 4.0, 0.35  # frequencies: cycles a window, cycles a pixel
# Rows or columns below which a window holds no such frequency; the slopes are unknown, then.
_LEAST_SIDE = 16
# Standard deviations of the spectra's blur in frequency bins, step by step, of each estimate.
_BLURS = ((2.5, 1.5, 0.8), (0.8, 0.8))
_MOST = 0.35  # of a slope: 28 degrees at a field of view of 66
_TOE = 0.03  # added inside the logarithm, as a share of the median radiance

Grey = NDArray[np.float32]


def convergence(pixels: Grey) -> Tensor:
    """(ESTIMATES, 4) slopes t_x and t_y, in 1 / plane units, and their standard deviations.

    Args:
        pixels: (H, W, 3), linear.
    """
    texture = _texture(pixels)
    # Slopes that are not finite would have OpenCV reflect places at infinity, for hours.
    if min(texture.shape) < _LEAST_SIDE or not np.isfinite(texture).all():
        return torch.tensor(ESTIMATES * [[0.0, 0.0, _MOST, _MOST]])
    slope, estimates = np.zeros(2), []
    for oriented, blurs in enumerate(_BLURS):
        for blur in blurs:
            step, std = _gauss_newton_step(_warped(texture, slope), bool(oriented), blur)
            slope = (slope + step).clip(-_MOST, _MOST)
        estimates.append([*slope, *std])
    return torch.tensor(estimates, dtype=torch.float32)


def _texture(pixels: Grey) -> Grey:
    """Log luminance without its local mean, over its local deviation."""
    width = int(np.clip(pixels.shape[1], *_COLUMNS))
    size = (width, max(1, round(width * pixels.shape[0] / pixels.shape[1])))
    luminance = cv2.resize(pixels.mean(axis=-1), size, interpolation=cv2.INTER_AREA)
    log = np.log(luminance / max(float(np.median(luminance)), 1e-6) + _TOE).astype(np.float32)
    log -= cv2.GaussianBlur(log, (0, 0), width / 51)
    deviation = cv2.sqrt(cv2.GaussianBlur(log * log, (0, 0), width / 32))
    return np.asarray(np.clip(log / (deviation + 1e-3), -3.0, 3.0), np.float32)


def _warped(texture: Grey, slope: NDArray[np.float64]) -> Grey:
    """The texture as an untilted plane shows it, if it is tilted by `slope`."""
    height, width = texture.shape
    x, y = _places(np.arange(width), np.arange(height)[:, None], height, width)
    near = (1.0 - slope[0] * x - slope[1] * y) * (2.0 / width)
    columns, rows = x / near + (width - 1) / 2, (height - 1) / 2 - y / near
    maps = columns.astype(np.float32), rows.astype(np.float32)
    warped = cv2.remap(texture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(warped, np.float32)


def _places(
    column: NDArray[np.int64], row: NDArray[np.int64], height: int, width: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plane coordinates of the centres of pixels."""
    return (2 * column + 1 - width) / width, (height - 1 - 2 * row) / width


def _gauss_newton_step(
    texture: Grey, oriented: bool, blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares change of the slopes, and its standard deviation.

    Args:
        texture: picture warped by the present slopes.
        oriented: leave the local orientation of each window free.
        blur: standard deviation of the spectra's blur, frequency bins.
    """
    power, centres = _window_spectra(texture, blur)
    side = power.shape[-1]
    k = np.fft.fftshift(np.fft.fftfreq(side))
    kx, ky = np.broadcast_arrays(k, -k[:, None])
    radius = np.hypot(kx, ky)
    half_plane = (kx > 0) | ((kx == 0) & (ky > 0))  # a real picture's spectrum is symmetric
    band = (radius >= _LONGEST / side) & (radius < _SHORTEST) & half_plane
    mean = np.log(power.mean(axis=0))
    down, right = np.gradient(mean)
    gx, gy, kx, ky = side * right[band], -side * down[band], kx[band], ky[band]
    # d log S / dt_x = x change[0] + y change[1], d log S / dt_y = x change[2] + y change[3]
    radial = gx * kx + gy * ky
    change = np.stack([radial + gx * kx, gx * ky, gy * kx, radial + gy * ky]).astype(np.float32)
    residual = np.log(power[:, band]) - mean[band]
    # What is free in each window is projected out of both sides of the equations.
    free = _free(kx, ky, side, oriented)
    change -= change @ free @ free.T
    residual = (residual - residual @ free @ free.T).clip(-2.0, 2.0)
    products = (change @ change.T).reshape(2, 2, 2, 2)
    normal = np.einsum("wa,taub,wb->wtu", centres, products, centres)  # by window w
    gradient = np.einsum("wa,wta->wt", centres, (residual @ change.T).reshape(-1, 2, 2))
    inverse = np.linalg.inv(normal.sum(axis=0) + 1e-3 * np.eye(2))
    step = inverse @ gradient.sum(axis=0)
    # Covariance from the scatter of windows, doubled as those that overlap by half count twice.
    scatter = gradient - normal @ step
    covariance = inverse @ (2.0 * scatter.T @ scatter) @ inverse + 1e-4 * inverse
    return step, np.sqrt(np.diagonal(covariance))


def _window_spectra(texture: Grey, blur: float) -> tuple[Grey, NDArray[np.float64]]:
    """(windows, side, side) periodograms, and the windows' centres (windows, 2), plane units."""
    height, width = texture.shape
    side = min(width // _WINDOWS, height) // 2 * 2
    corners = np.mgrid[0 : height - side + 1 : side // 2, 0 : width - side + 1 : side // 2]
    rows, columns = corners.reshape(2, -1)
    corner = zip(rows, columns, strict=True)
    power = _periodograms(np.stack([texture[y : y + side, x : x + side] for y, x in corner]), blur)
    middle = (side - 1) / 2
    return power, np.stack(_places(columns + middle, rows + middle, height, width), 1)


def _periodograms(windows: Grey, blur: float) -> Grey:
    """Of windows, blurred, with frequency 0 in the middle."""
    taper = np.hanning(windows.shape[-1]).astype(np.float32)
    windows = (windows - windows.mean(axis=(1, 2), keepdims=True)) * np.outer(taper, taper)
    half = torch.fft.rfft2(torch.from_numpy(windows))
    half_power = half.real.square() + half.imag.square()
    opposite = half_power[:, :, 1:-1].flip(1, 2).roll(1, 1)  # -k of the others
    whole = torch.fft.fftshift(torch.cat([half_power, opposite], 2), dim=(1, 2)).numpy()
    power = np.stack([cv2.GaussianBlur(each, (0, 0), blur) for each in whole])
    return np.asarray(power + (1e-4 * power.mean() + 1e-12), np.float32)


def _free(kx: NDArray[np.float64], ky: NDArray[np.float64], side: int, oriented: bool) -> Grey:
    """Orthonormal columns of what is free in each window: octaves, and local orientation."""
    octave = np.floor(np.log2(np.hypot(kx, ky) * side))
    columns = [octave == each for each in np.unique(octave)]
    if oriented:
        angle = 2.0 * np.arctan2(ky, kx)
        columns += [np.cos(angle), np.sin(angle)]
    return np.linalg.qr(np.stack(columns, axis=1).astype(np.float32))[0]


# The alignment branch: a network that measures the tilt of the plane from a single photograph.
#
# The paper's encoder has a branch for two rotation angles [henzler2021, section "Alignment"]. Here
# it is a separate network, because every capture needs the tilt and most need no latent vector.
# Cues are the light's falloff, the highlight's position and the texture's foreshortening. The first
# two depend on image position, so features are pooled on a grid, and a blurred image is an input of
# the last layers. The foreshortening of fine texture is measured separately (convergence); a
# second, small network weighs the three estimates of each angle. Trained on simulated photographs
# of known tilt (lab/matcap_lab/train/alignment.py).
#
# Angles are those of FlashSetup, in radians: positive tilt_x turns the plane's upper edge towards
# the camera, positive tilt_y its left edge.

WIDTH = 256  # columns of the input image
CONDITIONS = 3  # scalar inputs
UNKNOWN_FOV = 45.0  # degrees: input of a photograph whose field of view is not known
SHIPPED = Path(__file__).parent / "weights" / "alignment.safetensors"

_FORMAT = "matcap-alignment-2"
_REMEDY = "install matcap again, or train the branch with `matcap-lab prior align`"
_GRID = (3, 4)  # rows and columns of the pooled features
_BLURRED = (12, 16)  # rows and columns of the pooled picture
_WIDTHS = (32, 48, 64, 64)  # channels of the layers after the first
_UNIT = 0.15  # radians per unit of the last layer's means
PICTURE_CHANNELS = 5  # log colour, and the two image coordinates
_GROUP = 16  # channels normalised together
_LOG_STD = (math.log(0.002), math.log(0.3))  # limits of the standard deviation, log radians


class TiltEvidence(NamedTuple):
    """What a photograph says of its tilt: the branch's inputs."""

    picture: Tensor
    """(PICTURE_CHANNELS, h, WIDTH) of picture()."""
    conditions: Tensor
    """(CONDITIONS,) of conditions()."""
    slopes: Tensor
    """(ESTIMATES, 4) of convergence(), times the camera's distance: tangents."""


class Shortcut(nn.Module):
    """Layers with a shortcut: identity, or a 1 x 1 convolution where the shape changes."""

    def __init__(self, layers: Sequence[nn.Module], inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*layers)
        self.shortcut: nn.Module = nn.Identity()
        if inputs != outputs or stride != 1:
            self.shortcut = nn.Sequential(*convolution(inputs, outputs, 1, stride))

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, h, w) to (B, outputs, h / stride, w / stride)."""
        return F.relu(self.body(features) + self.shortcut(features))


def residual_block(inputs: int, outputs: int, stride: int) -> Shortcut:
    """Two 3 x 3 convolutions with a shortcut."""
    first, second = convolution(inputs, outputs, 3, stride), convolution(outputs, outputs, 3)
    return Shortcut([*first, nn.ReLU(inplace=True), *second], inputs, outputs, stride)


def convolution(inputs: int, outputs: int, side: int, stride: int = 1) -> list[nn.Module]:
    """A convolution with group normalisation."""
    return [
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
    ]


class Fusion(nn.Module):
    """Weighs the picture's angles and those of convergence, both axes by the same weights."""

    def __init__(self) -> None:
        super().__init__()
        sources = 1 + ESTIMATES
        inputs = 4 * sources + 2 + CONDITIONS + 1
        self.layers = nn.Sequential(
            *(nn.Linear(inputs, 48), nn.Tanh(), nn.Linear(48, 24), nn.Tanh()),
            nn.Linear(24, sources + 2),
        )

    def forward(
        self, mean: Tensor, log_std: Tensor, conditions: Tensor, slopes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (B, 2) each, in radians.

        Args:
            mean, log_std: (B, 2) of the picture.
            conditions: (B, CONDITIONS).
            slopes: (B, ESTIMATES, 4) as in TiltEvidence.
        """
        angles = torch.stack([slopes[..., 1], -slopes[..., 0]], dim=-1).atan().clamp(-0.35, 0.35)
        own = torch.cat([mean[:, None], angles], dim=1) / _UNIT
        certain = torch.cat([log_std[:, None], slopes[..., 2:].flip(-1).log()], dim=1) + 3.5
        gap = (own[:, 1:2] - own[:, 2:3]).abs()
        each = torch.cat([own, certain, gap], dim=1)
        other = torch.cat([own.abs(), certain, gap], dim=1).flip(-1)
        axis = torch.tensor([[0.0, 1.0]]).expand(len(mean), 1, 2)
        shared = conditions[..., None].expand(-1, -1, 2)
        out = self.layers(torch.cat([each, other, shared, axis], dim=1).transpose(1, 2))
        weights = (out[..., :-2] + torch.tensor([1.0] + [0.0] * ESTIMATES)).softmax(-1)
        fused = (weights * own.transpose(1, 2)).sum(-1) + 0.3 * out[..., -2]
        return _UNIT * fused, (out[..., -1] + math.log(0.1)).clamp(*_LOG_STD)


class PictureTilt(nn.Module):
    """The network of pictures: image and scalar inputs to two tilt angles."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(PICTURE_CHANNELS, 16, 5, 2, 2),
            nn.ReLU(inplace=True),
            *(residual_block(before, width, 2) for before, width in pairwise((16, *_WIDTHS))),
        )
        count = _WIDTHS[-1] * _GRID[0] * _GRID[1] + 3 * _BLURRED[0] * _BLURRED[1] + CONDITIONS
        self.hidden = nn.Sequential(nn.Linear(count, 192), nn.ReLU(), nn.Linear(192, 64), nn.ReLU())
        self.head = nn.Linear(64, 4)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, pictures: Tensor, conditions: Tensor) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (B, 2) each, in radians.

        Args:
            pictures: (B, PICTURE_CHANNELS, h, WIDTH) from picture().
            conditions: (B, CONDITIONS) from conditions().
        """
        features = self.features(pictures.contiguous(memory_format=torch.channels_last))
        pooled = F.adaptive_avg_pool2d(features, _GRID).float().flatten(1)
        blurred = F.adaptive_avg_pool2d(pictures[:, :3].float(), _BLURRED).flatten(1)
        hidden = self.hidden(torch.cat([pooled, blurred, conditions], dim=1))
        mean, log_std = self.head(hidden).float().chunk(2, dim=1)
        return _UNIT * mean, (log_std + math.log(0.1)).clamp(*_LOG_STD)


class Alignment(nn.Module):
    """The branch: a network of pictures, and the fusion of its angles with convergence."""

    def __init__(self) -> None:
        super().__init__()
        self.picture, self.fusion = PictureTilt(), Fusion()

    def forward(self, seen: TiltEvidence) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (1, 2) each, in radians."""
        stated = seen.conditions[None]
        mean, log_std = self.picture(seen.picture[None], stated)
        return self.fusion(mean, log_std, stated, seen.slopes[None])


def picture(pixels: NDArray[np.float32], width: int) -> Tensor:
    """(5, h, width) of (H, W, 3) linear pixels: log_colour, then picture_coordinates."""
    height = round(width * pixels.shape[0] / pixels.shape[1])
    small = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    linear = torch.from_numpy(np.ascontiguousarray(small.transpose(2, 0, 1)))
    return torch.cat([log_colour(linear), picture_coordinates(width, height)])


def log_colour(linear: Tensor) -> Tensor:
    """(3, h, w) log(L / median + 0.03) of linear radiance L; independent of the exposure."""
    median = linear.mean(0).median().clamp_min(1e-6)
    return torch.log(linear.clamp(0.0, 1.0) / median + _TOE)


def picture_coordinates(width: int, height: int) -> Tensor:
    """(2, h, w) coordinates of pixel centres: u right, in [-1, 1], v up, in the same unit."""
    u = (torch.arange(width) + 0.5) / width * 2.0 - 1.0
    v = (1.0 - (torch.arange(height) + 0.5) / height * 2.0) * height / width
    return torch.stack([u.expand(height, width), v[:, None].expand(height, width)])


def conditions(fov: Tensor, known: Tensor, radiometric: Tensor) -> Tensor:
    """(B, CONDITIONS) scalar inputs.

    Args:
        fov: (B,) degrees across the long side.
        known: (B,) bool, whether the field of view is from metadata rather than assumed.
        radiometric: (B,) bool, whether the photograph is RAW.
    """
    return torch.stack([(fov - 60.0) / 15.0, known.float(), radiometric.float()], dim=1)


def evidence(photo: Photo) -> TiltEvidence:
    """The branch's inputs of a photograph; pixels of its left_out mask become the median colour."""
    pixels = photo.pixels
    if photo.left_out is not None and not photo.left_out.all():
        out = photo.left_out[..., None]
        pixels = np.where(out, np.median(pixels[~photo.left_out], axis=0), pixels)
    known = photo.fov_source != "assumed"
    stated = conditions(
        torch.tensor([photo.fov if known else UNKNOWN_FOV]),
        torch.tensor([known]),
        torch.tensor([photo.radiometric]),
    )
    slopes = convergence(pixels) / math.tan(math.radians(photo.fov / 2.0))
    return TiltEvidence(picture(pixels, WIDTH), stated[0].float(), slopes)


def tilt_measurement(photo: Photo, branch: Alignment | None = None) -> TiltPrior:
    """Measure a photograph's tilt with its standard deviation, in radians.

    Args:
        photo: any size.
        branch: the networks; None is those shipped with matcap.

    Raises:
        MatcapError: the shipped networks are missing or damaged.
    """
    with torch.inference_mode():
        mean, log_std = (branch or _shipped())(evidence(photo))
    (x, y), (std_x, std_y) = mean[0].tolist(), log_std[0].exp().tolist()
    return TiltPrior((x, y), (std_x, std_y))


@lru_cache(maxsize=1)
def _shipped() -> Alignment:
    return load_alignment(SHIPPED)


def save_alignment(path: Path, branch: Alignment) -> None:
    """Write the network in half precision, atomically."""
    tensors = {name: tensor.half() for name, tensor in branch.state_dict().items()}
    write_tensors(path, tensors, {"matcap": _FORMAT})


def load_alignment(path: Path) -> Alignment:
    """Read the network.

    Raises:
        MatcapError: the file is missing, damaged or of another kind.
    """
    try:
        with safe_open(path, framework="pt") as file:
            if (file.metadata() or {}).get("matcap") != _FORMAT:
                raise MatcapError.at(path, f"this is not an alignment branch ({_FORMAT})", _REMEDY)
            return StoredTensors(file, path, _REMEDY).load(Alignment())
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(path, "the alignment branch cannot be read", _REMEDY) from error
