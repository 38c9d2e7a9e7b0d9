"""Windows that are compared, the start of fine-tuning, its teacher, matching of contrast."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet, relief_difference
from matcap.field.field import computes_bfloat16
from matcap.field.material import Material, lacking
from matcap.field.plane import Rectangle
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import FlashLight, render_flash
from matcap.flash.rectify import Plane
from matcap.space.decoder import ALIGNMENT, OUTPUTS, Decoder, DecoderConfig, with_cells
from matcap.space.freeze import AROUND, Drawing
from matcap.space.random_field import CELL_CHANNELS
from matcap.space.tuned import TunedDecoder
from matcap.statistics.compare import (
    UNSEEN,
    Descriptor,
    Encoding,
    Features,
    Weights,
    describe,
    distance,
    shading,
)
from matcap.statistics.lattice import Wave

# Windows of a photograph at which renderings are compared with it.
#
# A rendering is lit and viewed as at the place of its window. Comparing place by place separates
# relief from albedo: the shading of a bump depends on the direction to the flash, a dark spot does
# not.

# Windows in which photograph and rendering are compared; docs/notes/prior.md.
_HISS = 2e-3  # read noise, as a share of the clip level added to the radiance in shot noise
_TOGETHER = 4  # windows described at a time, so that they fit the processor's caches
_PAIRS = 64  # pairs of windows on which the bias of the L1 distance is measured
_LEAST_SCALE = 0.7  # lower limit of the correcting scale
_LEAST_SEEN = 0.3  # least valid share of a window


@dataclass(frozen=True)
class Windows:
    """Windows of a photograph: plane points, texture statistics and noise."""

    size: int
    """Side of the square windows, texels."""
    points: Tensor
    """(B, 3, size, size) plane points."""
    target: Descriptor
    """Descriptors of the photograph's windows, corrected for the bias of the L1 distance."""
    noise: Tensor | None = None
    """(B, 3, size, size) a sample of the sensor noise over `shot_deviation`, or None."""

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.points)


def cut_windows(plane: Plane, bank: Features, size: int, *, most: int | None = None) -> Windows:
    """Cut windows from a rectified picture, overlapping by about half, and describe them.

    Args:
        plane: the picture; windows with too few valid texels are omitted, unless all are.
        bank: features of the descriptors.
        size: side of the windows, texels, at most the picture's.
        most: largest number of windows, spread over the picture; None for all.
    """
    width, height = plane.size
    places = [(x, y) for y in _steps(height, size) for x in _steps(width, size)]
    seen = [
        (x, y)
        for x, y in places
        if float(plane.valid[y : y + size, x : x + size].float().mean()) >= _LEAST_SEEN
    ]
    places = seen or places
    places = places[:: -(-len(places) // most)] if most else places
    cut = torch.stack([plane.linear[:, y : y + size, x : x + size] for x, y in places])
    with torch.no_grad():
        described = [describe(some, plane.encoding, bank) for some in cut.split(_TOGETHER)]
    points = [
        plane_points(x, y, size, size, (width, height), dtype=torch.float32) for x, y in places
    ]
    noisy = None
    if plane.noise is not None:
        noise = plane.noise / shot_deviation(plane.linear)
        noisy = torch.stack([noise[:, y : y + size, x : x + size] for x, y in places])
    stacked = torch.stack(points)
    target = _raised(Descriptor.joined(described), *side_by_side(stacked, size))
    return Windows(size, stacked, target, noisy)


def side_by_side(points: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Indices of all ordered pairs of windows that lie about a window's width apart.

    They hardly overlap, and have nearly the same light and view.
    """
    centres = points[:, :2].mean(dim=(2, 3))[None].double()
    texel = float(points[0, 0, 0, 1] - points[0, 0, 0, 0])
    distance = torch.cdist(centres, centres)[0] / (texel * size)
    # Positions are rounded, and closer at a border.
    first, second = ((distance > 0.85) & (distance < 1.15)).nonzero(as_tuple=True)
    return first, second


def self_difference(windows: Windows, weights: Weights) -> float:
    """Mean distance between adjacent windows of a photograph, without their mean colour.

    At an error of 1 self-difference a rendering differs from the photograph as much as the
    photograph's parts do from each other. The mean colour depends on the light. NaN if no two
    windows are adjacent.

    Args:
        windows: of one photograph.
    """
    first, second = side_by_side(windows.points, windows.size)
    if not len(first):
        return math.nan
    target = windows.target
    pairs = target.select(first), target.select(second)
    return float(distance(*pairs, replace(weights, mean=0.0)).mean())


def _raised(target: Descriptor, first: Tensor, second: Tensor) -> Descriptor:
    """Scale target statistics to remove the contrast bias of the L1 distance.

    The mean L1 distance between two samples of a scattering statistic is least when one is scaled
    down. The scale is measured on pairs of the photograph's windows and the targets divided by it,
    except autocorrelations, most of which are noise.
    """
    if not len(first):
        return target
    some = torch.randperm(len(first), generator=torch.Generator().manual_seed(0))[:_PAIRS]

    def raised(level: Tensor) -> Tensor:
        return level / _best_scale(level[first[some]], level[second[some]])

    return replace(
        target,
        grams=tuple(map(raised, target.grams)),
        crosses=tuple(map(raised, target.crosses)),
        quantiles=tuple(map(raised, target.quantiles)),
    )


def _best_scale(sample: Tensor, target: Tensor) -> float:
    """The s in [_LEAST_SCALE, 1] that minimises the mean of |s sample - target|.

    The median of target / sample, weighted by |sample| over the window's mean |target|.
    """
    size = target.abs().flatten(1).mean(dim=1).clamp_min(UNSEEN)
    weight = (sample.abs().flatten(1) / size[:, None]).flatten()
    quotient = torch.where(sample == 0.0, 0.0, target / sample).flatten()
    ordered, order = quotient.sort()
    heavier = weight[order].double().cumsum(0)
    middle = int(torch.searchsorted(heavier, 0.5 * heavier[-1]))
    return min(1.0, max(_LEAST_SCALE, float(ordered[min(middle, len(ordered) - 1)])))


def shot_deviation(linear: Tensor) -> Tensor:
    """sqrt(L + hiss), proportional to the standard deviation of shot and read noise."""
    return (linear.clamp_min(0.0) + _HISS).sqrt()


def _steps(length: int, size: int) -> list[int]:
    """First texels of windows of a size that cover a length, overlapping by at least half."""
    count = max(1, math.ceil((length - size) / (size / 2)) + 1)
    return [round(i * (length - size) / max(1, count - 1)) for i in range(count)]


# Texture distance of a material to a photograph: windows rendered under its light.
#
# The loss of a decoder [henzler2021, sec. 4.3 and 4.6].


@dataclass(frozen=True)
class PhotographTarget:
    """Target statistics of windows of a photograph."""

    windows: Windows
    """Windows, with their statistics."""
    setup: FlashSetup
    encoding: Encoding
    """Colour space of the comparison."""
    bank: Features
    """Features whose statistics are compared."""
    waves: tuple[Wave, ...]
    """Frequency vectors of the photograph's lattice, cycles per texel."""
    texel_size: float
    """Side of a texel, plane units."""
    weights: Weights = Weights()
    expected: Tensor | None = None
    """(5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None."""
    drawing: Drawing | None = None
    """The drawing that the decoder reads, or None."""


def shuffled(count: int, seed: int) -> Iterator[int]:
    """Yield random permutations of 0 ... count - 1, without end."""
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield from torch.randperm(count, generator=generator).tolist()


def render_windows(maps: MapSet, target: PhotographTarget, places: Tensor, step: int) -> Tensor:
    """(B, 3, size, size) radiance of maps, lit and viewed as at `places`, with sensor noise."""
    windows = target.windows
    rendered = render_flash(maps, target.setup, windows.points[places])
    return rendered if windows.noise is None else with_noise(rendered, windows.noise[places], step)


def compare_windows(
    rendered: Tensor, target: PhotographTarget, places: Tensor, *, half_precision: bool
) -> Tensor:
    """Mean texture distance of renderings to the photograph's windows at `places`; a scalar."""
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        described = describe(rendered, target.encoding, target.bank)
    return distance(described, target.windows.target.select(places), target.weights).mean()


def with_noise(rendered: Tensor, noise: Tensor, step: int) -> Tensor:
    """Add sensor noise (Windows.noise) to renderings (B, 3, size, size).

    The noise is shifted and signed at random by step, and scaled by shot_deviation.
    """
    generator = torch.Generator().manual_seed(step)
    down, across, sign = torch.randint(noise.shape[-1], (3,), generator=generator).tolist()
    moved = noise.roll((down, across), dims=(-2, -1)) * (1.0 if sign % 2 else -1.0)
    return rendered + moved * shot_deviation(rendered.detach())


# Random decoder that fine-tuning starts from without a prior.
#
# The last AdaIN is set to the coarse fit's mean maps, the photograph's contrast of the diffuse
# albedo, and little relief. Fine-tuning then explains texture by albedo first, and by relief what
# depends on the direction to the flash. With more initial relief dark spots end as pits
# (docs/notes/prior.md).

# The head's first parameters; docs/notes/prior.md.
_CONTRAST_GAIN = 1.2  # logits of diffuse albedo per log radiance: d log sigmoid(x) / dx is below 1
_SPECULAR_CONTRAST = 0.1  # initial standard deviation of the logit of F0
_ROUGHNESS_CONTRAST = 0.1  # initial standard deviation of the logit of roughness
_RELIEF_CONTRAST = 0.15  # initial standard deviation of height, texels


def head_start(coarse: CoarseFit, contrast: Tensor) -> tuple[Tensor, Tensor]:
    """Initial mean and deviation (6,) of the raw outputs.

    Args:
        coarse: the uniform material.
        contrast: (3,) standard deviation of the photograph's log colour; see log_contrast.
    """
    return (
        torch.cat([coarse.logits(), torch.zeros(1)]),
        torch.cat(
            [
                contrast * _CONTRAST_GAIN,
                torch.tensor([_SPECULAR_CONTRAST, _ROUGHNESS_CONTRAST, _RELIEF_CONTRAST]),
            ]
        ),
    )


def log_contrast(linear: Tensor, valid: Tensor) -> Tensor:
    """(3,) standard deviation of log radiance less its shading, over valid texels.

    Args:
        linear: (3, H, W) radiance.
        valid: (H, W) bool; all texels are used where none is valid.
    """
    toe = 0.01 * float(linear.median()) + 1e-6
    log = torch.log(linear.clamp(0.0, 1.0) + toe)
    texture = log - shading(log[None])[0]
    texture = texture[:, valid] if bool(valid.any()) else texture.flatten(1)
    return texture.std(dim=1, correction=0).clamp(0.02, 1.5)


def untrained(config: DecoderConfig, coarse: CoarseFit, contrast: Tensor, seed: int) -> Decoder:
    """A random decoder with the mean maps of a coarse fit; for the latent vector zero.

    Args:
        contrast: (3,) from log_contrast.
        seed: of the weights.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = Decoder(config)
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.zero_()
        affine.bias.copy_(torch.cat(head_start(coarse, contrast)))
    return decoder


def reading_cells(decoder: Decoder, seed: int) -> Decoder:
    """Add cell channels to a decoder, with random weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        fresh = Decoder(replace(decoder.config, cells=CELL_CHANNELS))
    return with_cells(decoder, fresh)


# The exemplar's maps as a teacher of a decoder that reads its drawing.
#
# In every step of fine-tuning a window of one field of the exemplar is drawn, and the decoder's
# maps m are compared with the field's own, m', besides the texture distance to the photograph:
#
# 3 mean |log R_l - log R'_l| + mean |logit m - logit m'| + 0.1 mean |log S_k / S'_k|,
#
# m the diffuse albedo, F0 and roughness, R_l the radiance under a far light l 53 degrees off the
# normal, of which every step takes two, S_k the mean squared slope in octave k. Without the last
# term stains become slow relief, which a flash hardly tells from them. Figures in
# docs/notes/prior.md.

_LIT, _RELIEF = 3.0, 0.1  # weights of radiance and of slopes; docs/notes/prior.md
_FLAT = 0.005  # root-mean-square slope of an octave that is added to both
_LIGHTS = (
    (-0.8, 0.0, 0.6), (0.8, 0.0, 0.6), (0.0, 0.8, 0.6),
    (0.0, -0.8, 0.6), (0.57, 0.57, 0.6), (-0.57, 0.57, 0.6),
)  # fmt: skip
MARGIN = ALIGNMENT  # texels around a window that are decoded too
_AT_ONCE = 2  # lights in a step
_DARKEST = 0.01  # added to radiance before the logarithm
_TEACHER_EPSILON = 1e-3  # of albedo, F0 and roughness: bounds the logit at 0 and 1


@dataclass(frozen=True)
class Lesson:
    """A window of the teacher's field."""

    drawing: tuple[Tensor, ...]
    """Drawing.levels of the window and MARGIN around it."""
    maps: MapSet
    """Its maps, (1, ., size, size)."""
    seed: int
    """Of the choice of lights."""

    def loss(self, maps: MapSet) -> Tensor:
        """How far maps (1, ., size, size) are from the window's; see the module's equation."""
        generator = torch.Generator().manual_seed(self.seed)
        chosen = torch.randperm(len(_LIGHTS), generator=generator)[:_AT_ONCE].tolist()
        lit = [
            (_log_radiance(maps, _LIGHTS[n]) - _log_radiance(self.maps, _LIGHTS[n])).abs().mean()
            for n in chosen
        ]
        return (
            _LIT * torch.stack(lit).mean()
            + (_logits(maps) - _logits(self.maps)).abs().mean()
            + _RELIEF * relief_difference(maps, self.maps, _FLAT).mean()
        )


@dataclass(frozen=True)
class Teacher:
    """One field of the exemplar, at least as large, from which windows are taken."""

    drawing: Drawing
    field: Tensor
    """Stacked maps, with what the drawing needs around them."""
    size: int
    """Side of a window, texels."""

    @staticmethod
    def of(drawing: Drawing, size: int, seed: int) -> Teacher:
        """A field of a seed."""
        width, height = (max(side, size + 2 * MARGIN) for side in drawing.size)
        return Teacher(drawing, drawing.around(seed, Rectangle(0, 0, width, height)), size)

    def lesson(self, seed: int) -> Lesson:
        """A window at random."""
        beyond = AROUND + MARGIN
        whole, generator = self.size + 2 * beyond, torch.Generator().manual_seed(seed)
        y, x = (
            int(torch.randint(side - whole + 1, (), generator=generator))
            for side in self.field.shape[1:]
        )
        read = self.field[:, y : y + whole, x : x + whole]
        maps = read[None, :, beyond:-beyond, beyond:-beyond]
        texel_size = self.drawing.texel_size
        return Lesson(self.drawing.levels_of(read), MapSet.from_stacked(maps, texel_size), seed)


def _log_radiance(maps: MapSet, light: tuple[float, float, float]) -> Tensor:
    """(1, 3, H, W) log radiance under a far light, seen from straight above."""
    far = FlashLight.far(maps.diffuse.new_tensor(light))
    lit = far.onto(maps.normal, exact=True).radiance(maps.diffuse, maps.specular, maps.roughness)
    return (lit.clamp_min(0.0) + _DARKEST).log()


def _logits(maps: MapSet) -> Tensor:
    """(1, 5, H, W) logits of diffuse albedo, mean F0 and roughness."""
    specular = maps.specular.mean(dim=1, keepdim=True)
    return torch.logit(torch.cat([maps.diffuse, specular, maps.roughness], 1), eps=_TEACHER_EPSILON)


# Matching: corrects mean and contrast of a fine-tuned material to those of the photograph.
#
# Fine-tuning ends with too little contrast where it does not reproduce the structure, and possibly
# with a wrong mean (docs/notes/prior.md). Mean and deviation of every map are parameters of the
# last AdaIN. They are corrected by rendering the material as the whole photograph, comparing, and
# updating, _ROUNDS times. Diffuse albedo and height share one gain, because the photograph
# determines their contrast only jointly; F0 and roughness are not changed.
#
# The contrast ratio is measured by the mean over blocks and by their median; the gain is the ratio
# nearest to 1 between both. Scratches or clouds raise the mean only, and a global gain would not
# reproduce them.

# Matching; docs/notes/prior.md.
_ROUNDS = 3  # iterations
_BLOCK = 32  # texels: side of the blocks over which radiance is averaged
_CLIPPED = 0.97  # share of the clip level above which texels are not compared
_LEAST_COMPARED = 0.05  # least share of texels to compare
_DAMPING = 0.1  # added to the squared diffuse share; it limits shifts where most light is specular
_GAIN_STEP = (0.7, 1.4)  # limits of the gain in one iteration
_GAIN = (0.6, 1.7)  # limits of the whole gain
_SHIFT = 1.0  # limit of the whole shift, logits of diffuse albedo

_ALBEDO_EPSILON = 1e-5  # of albedo: bounds the logit at 0 and 1
_DIFFUSE, _HEIGHT = slice(0, 3), slice(5, 6)  # of the raw outputs


@dataclass(frozen=True)
class Correction:
    """Correction of mean and contrast."""

    gain: float
    """Factor on the deviations of diffuse albedo, in logits, and of height."""
    shift: Tensor
    """(3,) added to the mean of diffuse albedo, in logits."""

    def maps(self, maps: MapSet, mean: Tensor) -> MapSet:
        """Corrected maps; `mean` (OUTPUTS,) is of the raw outputs."""
        mean, shift = mean[_DIFFUSE, None, None], self.shift[:, None, None]
        logit = torch.logit(maps.diffuse, eps=_ALBEDO_EPSILON)
        diffuse = torch.sigmoid(mean + shift + self.gain * (logit - mean))
        return replace(maps, diffuse=diffuse, height=self.gain * maps.height)

    def decoder(self, tuned: TunedDecoder) -> TunedDecoder:
        """A copy of a decoder whose field has the corrected maps."""
        decoder = copy.deepcopy(tuned.decoder)
        affine = decoder.head.adain.affine
        with torch.no_grad():
            mean, deviation = affine.bias.split(OUTPUTS)
            _, slope = affine.weight.split(OUTPUTS)
            mean[_DIFFUSE] += self.shift
            for rows in (_DIFFUSE, _HEIGHT):
                deviation[rows] *= self.gain
                slope[rows] *= self.gain
        return replace(tuned, decoder=decoder)


def match_photograph(material: Material, plane: Plane, seed: int = 0) -> tuple[Material, MapSet]:
    """Correct a material's mean and contrast to those of the photograph.

    Args:
        material: fine-tuned to the photograph.
        plane: the photograph, lying; its noise, if known, is added to the rendering.
        seed: of the realisation that is compared.

    Returns:
        The material; and that realisation's corrected maps, as large as the photograph and
        upright, but for their mean height.

    Raises:
        UsageError: the material has no decoder.
    """
    tuned = material.part(TunedDecoder)
    if tuned is None:
        raise lacking(material.name, "decoder")
    maps = material.maps(*(plane.size[::-1] if tuned.turned else plane.size), seed=seed)
    mean, _ = tuned.decoder.head.adain.target(tuned.code)
    with torch.inference_mode():
        lying = maps.turned(1) if tuned.turned else maps
        by = correction(lying, mean, replace(material.setup, turned=False), plane)
        corrected = by.maps(maps, mean)
    # Outside inference mode, where weights could not be changed afterwards.
    return replace(material, generators={"decoder": by.decoder(tuned)}), corrected


def correction(maps: MapSet, mean: Tensor, setup: FlashSetup, plane: Plane) -> Correction:
    """The correction of maps to a photograph of their size.

    Identity where less than _LEAST_COMPARED of the photograph can be compared.

    Args:
        maps: of a decoder's field.
        mean: (OUTPUTS,) of its raw outputs.
        setup: camera and flash of the photograph.
    """
    width, height = plane.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    true = plane.encoding.log(plane.linear[None])
    contrast = _contrast(true)
    hiss = None if plane.noise is None else plane.noise / shot_deviation(plane.linear)
    moved, share = Correction(1.0, torch.zeros(3)), None
    for _ in range(_ROUNDS):
        now = moved.maps(maps, mean)
        clean = render_flash(now, setup, points)
        if share is None:
            share = _diffuse_share(now, clean, setup, points)
        seen = clean if hiss is None else clean + hiss * shot_deviation(clean)
        bright = torch.maximum(plane.linear.amax(0), seen.amax(0))
        compared = plane.valid & (bright < _CLIPPED * plane.encoding.limit)
        if float(compared.float().mean()) < _LEAST_COMPARED:
            break
        log = plane.encoding.log(seen[None])
        blocks = _Blocks(compared)
        moved = Correction(
            _bounded(moved.gain * _gain(contrast, _contrast(log), blocks), _GAIN),
            _shift((true - log)[0], share, moved.shift, blocks).clamp(-_SHIFT, _SHIFT),
        )
    return moved


class _Blocks:
    """Block means over the texels of a mask (H, W)."""

    def __init__(self, compared: Tensor) -> None:
        self._compared = compared
        self._size = min(_BLOCK, *compared.shape)
        self.weight = F.avg_pool2d(compared.float()[None], self._size)

    def __call__(self, values: Tensor) -> Tensor:
        """(C, H, W) to (C, rows, columns)."""
        seen = torch.where(self._compared, values, 0.0)
        return F.avg_pool2d(seen, self._size) / self.weight.clamp_min(1e-3)


def _contrast(log: Tensor) -> Tensor:
    """(3, H, W) squared difference of log radiance (1, 3, H, W) from its shading."""
    return (log - shading(log))[0].square()


def _diffuse_share(maps: MapSet, rendered: Tensor, setup: FlashSetup, points: Tensor) -> Tensor:
    """(3, H, W) derivative of log radiance by the logit of diffuse albedo, in [0, 1]."""
    black = replace(maps, diffuse=torch.zeros_like(maps.diffuse))
    glossy = render_flash(black, setup, points)
    share = (rendered - glossy) / rendered.clamp_min(1e-6)
    return share.clamp(0.0, 1.0) * (1.0 - maps.diffuse)


def _gain(wanted: Tensor, rendered: Tensor, blocks: _Blocks) -> float:
    """Contrast ratio: nearest to 1 between that of block means and that of block medians."""
    whole = blocks.weight[0] > 0.5
    if not whole.any():
        return 1.0
    wanted, rendered = (blocks(contrast).mean(dim=0)[whole] for contrast in (wanted, rendered))
    ratios = [
        float((measure(wanted) / measure(rendered).clamp_min(1e-12)).sqrt())
        for measure in (torch.mean, torch.median)
    ]
    least, most = min(ratios), max(ratios)
    return _bounded(_bounded(1.0, (least, most)), _GAIN_STEP)


def _bounded(value: float, limits: tuple[float, float]) -> float:
    return min(max(value, limits[0]), limits[1])


def _shift(difference: Tensor, share: Tensor, already: Tensor, blocks: _Blocks) -> Tensor:
    """(3,) damped least-squares shift of diffuse logits for differences of log radiance (3, H, W).

    With block means d of the differences, s of the derivative and weights w:
    sum(w s (d + s already)) / sum(w (s^2 + _DAMPING)). Blocks in the highlight have small s.
    """
    difference, share, weight = blocks(difference), blocks(share), blocks.weight
    explained = weight * share * (difference + share * already[:, None, None])
    return explained.sum((1, 2)) / (weight * (share.square() + _DAMPING)).sum((1, 2))
