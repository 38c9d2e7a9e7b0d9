"""`matcap-lab bench fields`: fields and tiles synthesised from true maps, without capture errors.

True maps of a sample of a known material are the exemplar. Exemplar, field and periodic tile are
relit and compared with other true samples. Further measures: length of joints relative to the
exemplar's, and phase error of the lattice at a large distance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import CHANNELS, MapSet
from matcap.errors import MatcapError
from matcap.example.example import Example, detail_bits, read_exemplified
from matcap.example.exemplar import DIFFUSE, HEIGHT, Exemplar, Floats
from matcap.example.variety import with_chosen_variety
from matcap.field.header import REMEDY
from matcap.field.plane import Rectangle
from matcap.statistics.lattice import find_lattice
from matcap_lab.bench.floors import true_exemplar
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.nsd import SqueezeNetStyle
from matcap_lab.simulate.specimen import EXAMPLES, Specimen

FIELDS = (
    "NSD of true maps: 1 is indistinguishable from another sample. Variety: the chosen value; "
    "joints: median length of a joint in the field over that in the exemplar; phase: largest phase "
    "error of a lattice's waves 16384 texels away, turns; seam: difference in log albedo and slope "
    "of neighbouring texels from different places over that of neighbours in the exemplar, median "
    "and 99th percentile."
)
_SIZE = (1024, 768)  # texels of the exemplar
_SEEDS = (0, 1)
_ELSEWHERE = (300, 100)  # texels: away from the origin, which might be special
_FAR = 16384  # texels
_SHORTEST = 8  # texels: of a joint
_JOINT = 9  # texels: wider valleys are none


@dataclass(frozen=True)
class TrueExample:
    """A material whose exemplar is the truth."""

    example: Example
    evaluator: Evaluator

    @cached_property
    def fields(self) -> list[MapSet]:
        """Fields of two seeds, of the evaluator's size."""
        texel = self.example.exemplar.texel_size
        side = self.evaluator.side(texel)
        read = [self.example.maps(s, Rectangle(*_ELSEWHERE, side, side), None) for s in _SEEDS]
        return [MapSet.from_stacked(torch.from_numpy(maps), texel) for maps in read]

    @cached_property
    def repeated(self) -> MapSet:
        """The exemplar as a periodic tile, shifted so that its borders lie in the middle."""
        texel = self.example.exemplar.texel_size
        side = self.evaluator.side(texel)
        tile = self.example.repeating().stacked()
        around = tile.roll((side // 2, side // 2), (1, 2)).repeat(1, 2, 2)[:, :side, :side]
        return MapSet.from_stacked(around, texel)


Samples = list[MapSet]  # of what is measured


def fields_experiment(
    subjects: Sequence[Specimen], evaluation: EvaluationSettings | None = None
) -> Experiment[TrueExample, Samples]:
    """Exemplar, field and periodic tile, from true maps of each subject."""
    settings = evaluation or EvaluationSettings()
    style = SqueezeNetStyle()

    def prepare(subject: Specimen) -> TrueExample:
        maps = subject.realise(*_SIZE, 2.0 / _SIZE[0])
        evaluator = Evaluator(subject, subject.setup, settings, {"NSD": style})
        return TrueExample(true_example(maps), evaluator)

    return Experiment(
        "fields",
        {subject.name: partial(prepare, subject) for subject in subjects},
        {
            "exemplar": Configuration(lambda true, _seed: [true.example.piece()]),
            "field": Configuration(lambda true, _seed: true.fields),
            "repeated": Configuration(lambda true, _seed: [true.repeated]),
        },
        (nsd, of_field),
        settings=settings,
    )


def nsd(true: TrueExample, samples: Samples) -> Mapping[str, Value]:
    """Normalised style distance, the mean over samples."""
    light = true.evaluator.flash.intensity
    distances = [true.evaluator.style_ratio_of(maps, light) for maps in samples]
    return {"NSD": sum(distances) / len(distances)}


def of_field(true: TrueExample, samples: Samples) -> Mapping[str, Value]:
    """The field's variety, joints, phase error and seam contrast; NaN where there are too few."""
    if samples is not true.fields:
        return {}
    example, exemplar = true.example, true.example.exemplar
    joint, own = joint_length(samples[0].height[0].numpy()), joint_length(exemplar.height[0])
    off = phase_off(example)
    places = example.places(_SEEDS[0], Rectangle(*_ELSEWHERE, *samples[0].size), None)
    contrast = seam_contrast(
        samples[0].stacked().numpy(), places.astype(np.int64), exemplar.stacked(),
        exemplar.texel_size,
    )  # fmt: skip
    return {
        "variety": example.variety,
        "joints": joint / own if joint and own else math.nan,
        "phase": math.nan if off is None else off,
        **contrast,
    }


def true_example(maps: MapSet) -> Example:
    """True maps as an exemplar, indexed as by a capture."""
    exemplar = Exemplar.certain(maps.stacked().float().numpy(), maps.texel_size)
    width, height = maps.size
    colour = torch.from_numpy(exemplar.diffuse).clamp(0.0, 1.0) ** (1.0 / 2.2)
    lattice = find_lattice(colour, torch.ones(height, width, dtype=torch.bool))
    return with_chosen_variety(Example.of(exemplar, lattice.waves))


def joint_length(height: NDArray[np.float32]) -> float | None:
    """Median length in texels of narrow valleys between their crossings; None below 20 valleys."""
    smooth = cv2.GaussianBlur(height.astype(np.float32), (0, 0), 1.0)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_JOINT, _JOINT))
    deep = cv2.morphologyEx(smooth, cv2.MORPH_BLACKHAT, kernel)
    top = float(np.quantile(deep, 0.999))
    if top <= 0.0:
        return None
    eight = (deep / top * 255.0).clip(0.0, 255.0).astype(np.uint8)
    _, valleys = cv2.threshold(eight, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    lines = (cv2.ximgproc.thinning(valleys) > 0).astype(np.uint8)
    around = cv2.filter2D(lines, -1, np.ones((3, 3), np.uint8)) - lines
    ends = lines * (around < 3)
    _, _, stats, _ = cv2.connectedComponentsWithStats(ends, connectivity=8)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    long = sizes[sizes >= _SHORTEST]
    return float(np.median(long)) if len(long) >= 20 else None


def phase_off(example: Example) -> float | None:
    """Largest phase error of the lattice 16384 texels away, in periods; None without one."""
    order = example.index.lattice
    if order is None:
        return None
    bits = detail_bits(example.exemplar)
    worst = 0.0
    for x, y in ((_FAR, 0), (0, _FAR), (-_FAR, _FAR)):
        places = example.places(0, Rectangle(x, y, 256, 256), None).astype(np.int64) >> bits
        columns, rows = (np.arange(at, at + 256) >> bits for at in (x, y))
        wanted = order.ideal_phases(0, columns[None, :], rows[:, None], (None, None))
        difference = (order.phases(places[..., 0], places[..., 1]) - wanted).astype(np.int16)
        turns = np.exp(2j * np.pi * difference.astype(np.float64) / 2**16).mean(axis=(0, 1))
        worst = max(worst, float(np.abs(np.angle(turns)).max()) / (2.0 * np.pi))
    return worst


def grating(period: float, angle: float, size: tuple[int, int] = _SIZE) -> Example:
    """True maps of a weave of one period (texels) at an angle, degrees, as an exemplar."""
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float64)
    turn = np.deg2rad(angle)
    waves = [(np.cos(turn) / period, np.sin(turn) / period)]
    waves += [(-np.sin(turn) / period, np.cos(turn) / period)]
    threads = sum(np.cos(2.0 * np.pi * (fx * x + fy * y)) for fx, fy in waves)
    noise = np.random.default_rng(0).standard_normal(x.shape)
    plane = (0.4 + 0.1 * threads + 0.02 * noise).clip(0.0, 1.0).astype(np.float32)[None]
    exemplar = Exemplar(
        plane.repeat(3, axis=0), 0.1 * plane, plane, 0.01 * plane,
        np.ones((len(CHANNELS), *x.shape), np.float32), 2.0 / size[0],
    )  # fmt: skip
    return replace(Example.of(exemplar, tuple(waves)), variety=1.0)


_DARKEST = 1e-3  # albedo
_FEWEST = 100  # pairs: with fewer, no value
_SEAMS = ("seam albedo", "seam albedo 99 %", "seam slope", "seam slope 99 %")


def seam_contrast(
    maps: Floats, places: NDArray[np.int64], exemplar: Floats, texel_size: float
) -> dict[str, float]:
    """Seam contrast of albedo (log, RGB) and slope by column; NaN where there are too few seams.

    Median, and 99th percentile, of differences across seams (neighbours whose sources are none)
    over that of the exemplar's: 1 is indistinguishable. Style distances hardly respond to seams.

    Args:
        maps: (6 or 8, H, W) of the field.
        places: (H, W, 2) x, y of each texel's source in the exemplar, texels.
        exemplar: (6 or 8, h, w) maps.
        texel_size: in plane units.
    """
    seams = [
        (np.diff(places, axis=axis) != step).any(axis=-1)
        for axis, step in ((0, (0, 1)), (1, (1, 0)))
    ]
    if sum(int(some.sum()) for some in seams) < _FEWEST:
        return dict.fromkeys(_SEAMS, math.nan)
    contrasts: list[float] = []
    for here, own in zip(_seen(maps, texel_size), _seen(exemplar, texel_size), strict=True):
        there = [steps[some] for steps, some in zip(_steps(here), seams, strict=True)]
        at_seams = np.quantile(np.concatenate(there), (0.5, 0.99))
        usual = np.quantile(np.concatenate([one.ravel() for one in _steps(own)]), (0.5, 0.99))
        contrasts += (at_seams / np.maximum(usual, 1e-9)).tolist()
    return dict(zip(_SEAMS, contrasts, strict=True))


def _seen(maps: Floats, texel_size: float) -> tuple[Floats, Floats]:
    """(3, H, W) log albedo and (2, H, W) slopes."""
    height = maps[HEIGHT][0] / np.float32(texel_size)
    slopes = np.stack([np.gradient(height, axis=axis) for axis in (0, 1)])
    return np.log(np.maximum(maps[DIFFUSE], _DARKEST)), slopes


def _steps(planes: Floats) -> list[Floats]:
    """Euclidean distance over channels between neighbours, along y and along x."""
    return [np.sqrt(np.square(np.diff(planes, axis=axis)).sum(axis=0)) for axis in (1, 2)]


# `matcap-lab bench repetition`: does a field by example repeat, and how large are its copies?
#
# 1. *Correlation*: the largest autocorrelation at shifts longer than a copied patch, and for
#    reference the cross-correlation of two seeds: chance and a lattice's periodicity contribute to
#    both.
# 2. *Copies*: connected texels that are neighbours in the exemplar form a patch; the share of
#    texels in patches of each size.
# 3. *Diversity*: mean difference of two seeds, texel by texel, over that of random pairs of the
#    exemplar's texels: 0 for equal maps, 1 for independent ones.

REPETITION = (
    "With itself, of two seeds: largest correlation of roughness at shifts of more than 128 texels "
    "(matcap_lab/bench/fields.py); below n, larger: share of texels in verbatim copies of that "
    "size, texels; diversity: difference of two seeds, 1 for unrelated maps."
)
NEAR = 128  # texels: twice the side of the patches that a field is initialised with
SIZES = (16, 256, 1024, 4096, 16384, 65536)  # texels of a patch, upper ends of the classes
_TWO_SEEDS = (1, 2)
_ROUGHNESS = 4  # among the stacked maps
_EXEMPLAR = (1024, 768)  # texels of a simulated one
_COPIED = 1024  # texels a side of the map whose copies are counted

MapArray = NDArray[np.float32]


def example_of(material: str) -> Example:
    """The exemplar of a .matcap file, or the true maps of a simulated material of that name.

    Raises:
        MatcapError: the file has none.
    """
    if material.endswith(".matcap"):
        exemplified = read_exemplified(Path(material))
        if exemplified is None:
            raise MatcapError.at(material, "there is no exemplar in it", REMEDY)
        return exemplified.example
    exemplar = true_exemplar(material, *_EXEMPLAR)
    maps = torch.from_numpy(exemplar.stacked())
    lattice = find_lattice(maps, torch.ones(maps.shape[1:], dtype=torch.bool))
    return Example.of(exemplar, lattice.waves)


def repetition_experiment(
    materials: Sequence[str], size: int
) -> Experiment[Example, list[MapArray]]:
    """Fields of two seeds, `size` texels a side.

    Materials are simulated ones by name, all by default, or .matcap files.
    """

    def read(example: Example, _seed: int) -> list[MapArray]:
        return [example.maps(seed, Rectangle(0, 0, size, size), None) for seed in _TWO_SEEDS]

    return Experiment(
        "repetition",
        {Path(material).stem: partial(example_of, material) for material in materials or EXAMPLES},
        {f"{size} x {size} texels": Configuration(read)},
        (correlations, copied, diversity_of_seeds),
        settings=[(m, Path(m).stat().st_mtime_ns) for m in materials if Path(m).is_file()],
    )


def correlations(_example: Example, maps: list[MapArray]) -> Mapping[str, Value]:
    """Largest autocorrelation of roughness, and largest cross-correlation of two seeds."""
    first, second = (one[_ROUGHNESS] for one in maps)
    return {"with itself": correlation(first, first), "of two seeds": correlation(first, second)}


def copied(example: Example, _maps: list[MapArray]) -> Mapping[str, Value]:
    """Shares of texels in verbatim copies, by their size."""
    places = example.places(_TWO_SEEDS[0], Rectangle(0, 0, _COPIED, _COPIED), None)
    names = [*(f"below {size}" for size in SIZES), "larger"]
    return dict(zip(names, copies(places), strict=True))


def diversity_of_seeds(example: Example, maps: list[MapArray]) -> Mapping[str, Value]:
    """Mean difference of two seeds over that of random pairs of texels."""
    texels = example.exemplar.stacked().reshape(len(maps[0]), -1)
    drawn = np.random.default_rng(_TWO_SEEDS[0]).permutation(texels.shape[1])
    unrelated = _rms_difference(texels, texels[:, drawn])
    return {"diversity": float((_rms_difference(*maps) / unrelated).mean())}


def correlation(first: MapArray, second: MapArray) -> float:
    """Largest correlation of two square maps at shifts of more than NEAR texels along x or y."""
    size = len(first)
    spectra = [np.fft.rfft2((one - one.mean()) / one.std()) for one in (first, second)]
    shifted = np.fft.irfft2(spectra[0] * spectra[1].conj(), s=first.shape) / first.size
    lag = np.minimum(np.arange(size), size - np.arange(size))
    far = np.maximum(lag[:, None], lag[None, :]) > NEAR
    return float(shifted[far].max())


def copies(places: NDArray[np.int16]) -> tuple[float, ...]:
    """Share of texels in patches below each of SIZES, and in larger ones.

    `places` (H, W, 2) are x, y of each texel's source in the exemplar.
    """
    rows, columns = places.shape[:2]
    wide = places.astype(np.int32)
    # Texels are at even rows and columns of this picture, links between neighbours at odd ones.
    links = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    links[::2, ::2] = 1
    links[::2, 1::2] = (np.diff(wide, axis=1) == [1, 0]).all(-1)
    links[1::2, ::2] = (np.diff(wide, axis=0) == [0, 1]).all(-1)
    _, labels = cv2.connectedComponents(links, connectivity=4, ltype=cv2.CV_32S)
    counts = np.bincount(labels[::2, ::2].ravel())
    shares = np.bincount(np.searchsorted(SIZES, counts, "right"), counts, len(SIZES) + 1)
    return tuple((shares / (rows * columns)).tolist())


def _rms_difference(first: MapArray, second: MapArray) -> NDArray[np.float64]:
    """Root mean square difference of each of the stacked maps (6, ...), RGB as one."""
    planes = [np.abs(a - b).mean(dtype=np.float64) for a, b in zip(first, second, strict=True)]
    starts = np.cumsum([0, *CHANNELS.values()])[:-1]
    return np.maximum(np.add.reduceat(planes, starts), 1e-9)
