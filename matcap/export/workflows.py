"""Conversion of maps to a target's workflow, and parameters fitted to its shading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.export.job import (
    ExportJob,
    MapRows,
    Picture,
    bands,
    brightest_channel,
    mean_channel,
    rgb,
)
from matcap.export.shading import (
    DIRECTIONS,
    MATCAP,
    Geometry,
    TargetShading,
    diffuse_lobe,
    specular_lobe,
)

# Fit parameters to a target's shading model, so that it renders matcap's reflectance.
#
# Shading models differ: a specular layer darkens the diffuse part, Disney's diffuse lobe is not
# Lambert's, Unity's mobile term is twice as bright on polished surfaces. For a flat surface the
# difference depends on roughness and F0 alone. Once a target, over a grid of both, three factors
# (on diffuse albedo, F0 and roughness) minimise the difference of reflected light under the
# directions of the residual (shading.py). Textures are written with these factors; the remaining
# difference is the residual.

_ROUGH, _F0 = 64, 33
# Factors on roughness that are tried where the target's lobe has another shape ("mobile").
_RATIOS = np.linspace(0.7, 1.3, 61)
_ROUNDS = 4  # fixed-point iterations, which converge to 1e-4
_LEANING, _LEAN = 512, 30.0  # number of tilted normals, and their largest tilt in degrees
_MOST_TOGETHER = 0.9  # largest correlation of diffuse and specular errors in ErrorWeights
_LEAST = 0.02  # least roughness of the grid: narrower highlights fall between the directions


@dataclass(frozen=True)
class FittedTables:
    """(64, 33) tables of factors: rows by roughness, columns by sqrt(F0), uniform in [0, 1]."""

    diffuse: Picture
    """Factor on the diffuse albedo."""
    specular: Picture
    """Factor on F0."""
    roughness: Picture
    """Factor on the roughness."""
    each: bool = False
    """The layer darkens each channel by its own reflection; else all by the brightest one's."""

    def albedo(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W, 1 or 3) factors on diffuse albedo; f0 (H, W[, 3]), roughness (H, W)."""
        taken = f0 if self.each else brightest_channel(f0)
        factor = self._at(self.diffuse, taken, roughness)
        return factor if factor.ndim == 3 else factor[..., None]

    def f0(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W[, 3]) F0 to write; may exceed 1."""
        return f0 * self._at(self.specular, f0, roughness)

    def rough(self, f0: Picture, roughness: Picture) -> Picture:
        """(H, W) roughness to write."""
        factor = self._at(self.roughness, mean_channel(f0), roughness)
        return np.clip(roughness * factor, 0.0, 1.0)

    @staticmethod
    def _at(table: Picture, f0: Picture, roughness: Picture) -> Picture:
        if np.ptp(table) < 1e-5:  # most tables are 1 throughout
            return np.full_like(f0, table.flat[0])
        if f0.ndim == 3:
            by_channel = (FittedTables._at(table, one, roughness) for one in np.moveaxis(f0, -1, 0))
            return np.stack(list(by_channel), axis=-1)
        y = np.clip(roughness, 0.0, 1.0) * np.float32(_ROUGH - 1)
        x = np.sqrt(np.clip(f0, 0.0, 1.0)) * np.float32(_F0 - 1)
        factors = cv2.remap(table, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(factors, dtype=np.float32)


@dataclass(frozen=True)
class ErrorWeights:
    """Weights of errors of diffuse albedo and F0, by the light that each reflects."""

    diffuse: Picture
    """(H, W) mean reflected light of diffuse albedo 1, under irradiance 1."""
    specular: Picture
    """(H, W) mean reflected light of F0 = 1."""
    together: Picture
    """(H, W) overlap of both over directions, [0, 1): errors of opposite sign cancel that much."""

    @staticmethod
    def at(roughness: Picture) -> ErrorWeights:
        """The weights at (H, W) roughness."""
        place = np.rint(np.clip(roughness, 0.0, 1.0) * (_ROUGH - 1)).astype(np.intp)
        return ErrorWeights(*(table[place] for table in _light()))


@lru_cache(maxsize=1)
def _light() -> tuple[Picture, Picture, Picture]:
    """ErrorWeights by roughness, over tilted normals and all DIRECTIONS."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)[None, :, None]
    number = torch.arange(_LEANING, dtype=torch.float64) + 0.5
    up = 1.0 - (1.0 - math.cos(math.radians(_LEAN))) * number / _LEANING  # uniform over the cap
    turn, out = math.pi * (1.0 + 5.0**0.5) * number, (1.0 - up.square()).sqrt()
    normals = torch.stack([out * turn.cos(), out * turn.sin(), up])[:, None, :]
    shown, mirrored = [], []
    for directions in DIRECTIONS:
        at = Geometry.of(normals, *directions)
        lit = at.light * at.above
        shown.append((diffuse_lobe(MATCAP, at, rough, None) * lit).expand(1, _ROUGH, -1))
        mirrored.append(specular_lobe(MATCAP, at, torch.ones_like(rough), 1.0, rough) * lit)
    diffuse, specular = (torch.cat(one).movedim(1, 0).flatten(1) for one in (shown, mirrored))
    means = diffuse.mean(1), specular.mean(1)
    relative = torch.minimum(diffuse / means[0][:, None], specular / means[1][:, None])
    together = relative.mean(1).clamp(max=_MOST_TOGETHER)
    planes = (one.numpy().astype(np.float32) for one in (*means, together))
    return next(planes), next(planes), next(planes)


@lru_cache(maxsize=64)
def fitted_tables(shading: TargetShading) -> FittedTables:
    """The tables of a target; all 1 if its shading is matcap's."""
    rough = torch.linspace(0.0, 1.0, _ROUGH, dtype=torch.float64).clamp_min(_LEAST)
    f0 = torch.linspace(0.0, 1.0, _F0, dtype=torch.float64).square().clamp_min(1e-4)
    rough, f0 = (v[None].contiguous() for v in torch.meshgrid(rough, f0, indexing="ij"))
    flat = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
    flat = flat.expand(3, _ROUGH, _F0)
    places = [Geometry.of(flat, *pair) for pair in DIRECTIONS]
    factor, ratio = _nearest(shading, places, f0, rough)
    nearest = (rough * ratio).clamp(max=1.0)
    # The layer reflects the F0 that is written.
    layer = (f0 * factor).clamp(max=1.0)
    meant = torch.stack([diffuse_lobe(MATCAP, at, rough, None) * at.light for at in places])
    shown = torch.stack([diffuse_lobe(shading, at, nearest, layer) * at.light for at in places])
    albedo = meant.sum(0) / shown.sum(0).clamp_min(1e-6)
    tables = [table[0].numpy().astype(np.float32) for table in (albedo, factor, ratio)]
    return FittedTables(tables[0], tables[1], tables[2], shading.each)


def _nearest(
    shading: TargetShading, places: list[Geometry], f0: Tensor, rough: Tensor
) -> tuple[Tensor, Tensor]:
    """(factor on F0, factor on roughness) with the least difference, for each grid point."""
    meant = torch.stack([specular_lobe(MATCAP, at, f0, 1.0, rough) * at.light for at in places])
    best = torch.full_like(f0, torch.inf)
    factor, chosen = torch.ones_like(f0), torch.ones_like(f0)
    # 1 first: it is kept where no other ratio is better.
    ratios = _RATIOS if shading.specular == "mobile" else np.ones(1)
    for ratio in sorted(ratios, key=lambda one: abs(one - 1.0)):
        tried = (rough * float(ratio)).clamp(max=1.0)
        scale = torch.ones_like(f0)
        # Multiple scattering is quadratic in F0: iterate.
        for _ in range(_ROUNDS if shading.compensated else 1):
            shown = torch.stack(
                [specular_lobe(shading, at, f0 * scale, 1.0, tried) * at.light for at in places]
            )
            step = meant.sum(0) / shown.sum(0).clamp_min(1e-9)
            scale = scale * step
        off = (meant - step * shown).abs().sum(0)
        better = off < best * (1.0 - 1e-6)
        best = torch.where(better, off, best)
        factor = torch.where(better, scale, factor)
        chosen = torch.where(better, ratio * torch.ones_like(f0), chosen)
    return factor, chosen


# Conversion to the metallic workflow: base colour, metallic, and F0 of dielectrics.
#
# diffuse = base (1 - metallic), F0 = dielectric (1 - metallic) + base metallic. This cannot
# represent every diffuse albedo and F0. Of three forms, the one with the smallest residual is
# written (presets.py):
#
# - plain: metallic is above 0 only where F0 is above 0.2, which no common dielectric reaches. The
#   base colour reproduces the diffuse albedo, metallic the mean F0.
# - tinted: the same metallic; the base colour is the least-squares compromise of diffuse and F0.
# - free: base colour, metallic and dielectric F0 minimise the difference of light; exact for maps
#   of a metallic material. Dielectrics may become metallic, so it must be clearly better.
#
# shading.residuals measures the remaining error.

Form = Literal["plain", "tinted", "free"]
FORMS: tuple[Form, ...] = get_args(Form)

_HALVINGS = 12  # bisections of metallic: finer than 8 bits
# F0 where metallic starts, and where it may be 1. Diamond, the highest common dielectric, has 0.17;
# titanium, the lowest bare metal, 0.5.
FIRST_METAL, SURE_METAL = 0.2, 0.3
_FIRST_STEPS, _FINER = 8, 6  # free form: steps over [0, 1], then halvings around the best
_BETTER = 1e-9  # least gain, in squared light, for another metallic


@dataclass(frozen=True)
class Metallic:
    """A material in the metallic workflow."""

    base: Picture
    """(H, W, 3) base colour in [0, 1]."""
    metallic: Picture
    """(H, W) in [0, 1]."""
    dielectric: Picture
    """(H, W) F0 of the dielectric part."""


@dataclass(frozen=True)
class MetallicAim:
    """The reflectance to reproduce, and the target's limits."""

    diffuse: Picture
    """(H, W, 3) diffuse albedo."""
    specular: Picture
    """(H, W) or (H, W, 3) F0."""
    roughness: Picture
    """(H, W) perceptual roughness."""
    lowest: float
    """Smallest F0 of a dielectric in the target."""
    highest: float
    """Largest; equal to `lowest` where F0 is fixed."""
    below: float = 1.0
    """Diffuse albedo over base colour, of a dielectric."""


def to_metallic(wanted: MetallicAim, form: Form = "plain") -> Metallic:
    """Convert to the metallic workflow, in one of the forms."""
    if form == "free":
        return _free(wanted)
    plain = _plain(wanted)
    if form == "plain":
        return plain
    tried = _Tried.of(wanted, ErrorWeights.at(wanted.roughness), plain.metallic, plain.dielectric)
    return Metallic(tried.base, plain.metallic, plain.dielectric)


def _plain(wanted: MetallicAim) -> Metallic:
    """The plain form: exact diffuse albedo; metallic by bisection for the mean F0."""
    specular = mean_channel(wanted.specular)
    dielectric = np.clip(specular, wanted.lowest, wanted.highest).astype(np.float32)
    allowed = np.clip((specular - FIRST_METAL) / (SURE_METAL - FIRST_METAL), 0.0, 1.0)
    low, high = np.zeros_like(specular), np.ones_like(specular)
    if (allowed > 0.0).any():
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            base = _diffuse_base(wanted, middle).mean(axis=-1)
            f0 = wanted.highest * (1.0 - middle) + middle * base
            low, high = np.where(f0 < specular, middle, low), np.where(f0 < specular, high, middle)
    metallic = np.where(specular > wanted.highest, high * allowed, 0.0).astype(np.float32)
    return Metallic(_diffuse_base(wanted, metallic), metallic, dielectric)


def _diffuse_base(wanted: MetallicAim, metallic: Picture) -> Picture:
    """Base colour for the diffuse albedo; where that is black, for F0."""
    rest = (wanted.below * (1.0 - metallic))[..., None]
    black = wanted.diffuse.max(axis=-1, keepdims=True) < 1e-4
    base = np.where(black, rgb(wanted.specular), wanted.diffuse / np.maximum(rest, 1e-6))
    return np.clip(base, 0.0, 1.0).astype(np.float32)


def _free(wanted: MetallicAim) -> Metallic:
    """The free form: line search over metallic, base and dielectric by least squares."""
    weights = ErrorWeights.at(wanted.roughness)
    metallic = np.zeros_like(wanted.roughness)
    best = _Tried.of(wanted, weights, metallic)
    steps = [np.full_like(metallic, step / _FIRST_STEPS) for step in range(1, _FIRST_STEPS + 1)]
    for step in steps:
        metallic, best = best.or_better(_Tried.of(wanted, weights, step), metallic, step)
    width = np.float32(1.0 / _FIRST_STEPS)
    for _ in range(_FINER):
        width /= 2.0
        middle = metallic
        for step in (middle - width, middle + width):
            step = np.clip(step, 0.0, 1.0)
            metallic, best = best.or_better(_Tried.of(wanted, weights, step), metallic, step)
    return Metallic(best.base, metallic, best.dielectric)


@dataclass(frozen=True)
class _Tried:
    """Base colour and dielectric F0 for a given metallic, and the squared error (H, W)."""

    base: Picture
    dielectric: Picture
    off: Picture

    @staticmethod
    def of(
        wanted: MetallicAim,
        weights: ErrorWeights,
        metallic: Picture,
        dielectric: Picture | None = None,
    ) -> _Tried:
        """Solve by weighted least squares: both equations are linear in base and dielectric."""
        rest = np.float32(1.0) - metallic
        below = np.float32(wanted.below) * rest
        f0 = rgb(wanted.specular)
        if dielectric is None:
            # Eliminate the base colour: metallic diffuse = below (F0 - dielectric rest).
            mean = below * f0.mean(axis=-1) - metallic * wanted.diffuse.mean(axis=-1)
            dielectric = np.clip(
                mean / np.maximum(below * rest, 1e-6), wanted.lowest, wanted.highest
            ).astype(np.float32)
        diffused, mirrors = weights.diffuse * below, weights.specular * metallic
        diffuse = weights.diffuse[..., None] * wanted.diffuse
        specular = weights.specular[..., None] * (f0 - (dielectric * rest)[..., None])
        both = weights.together
        size = diffused**2 + 2.0 * both * diffused * mirrors + mirrors**2
        along = (diffused + both * mirrors)[..., None] * diffuse
        along += (mirrors + both * diffused)[..., None] * specular
        base = np.clip(along / np.maximum(size, 1e-12)[..., None], 0.0, 1.0).astype(np.float32)
        more, brighter = diffused[..., None] * base - diffuse, mirrors[..., None] * base - specular
        off = more**2 + 2.0 * both[..., None] * more * brighter + brighter**2
        return _Tried(base, dielectric, off.sum(axis=-1))

    def or_better(
        self, other: _Tried, metallic: Picture, others: Picture
    ) -> tuple[Picture, _Tried]:
        """Per texel, the candidate with the smaller error, and its metallic."""
        nearer = other.off < self.off - _BETTER
        chosen = _Tried(
            np.where(nearer[..., None], other.base, self.base),
            np.where(nearer, other.dielectric, self.dielectric),
            np.where(nearer, other.off, self.off),
        )
        return np.where(nearer, others, metallic), chosen


# Conversion to the specular workflow: base colour under a specular layer of any F0.
#
# The base colour is raised by what the layer darkens in the target's shading model; values
# above 1 are clipped, with a note.


def base_colour(piece: MapRows, shading: TargetShading) -> Picture:
    """(H, W, 3) base colour that the target renders as the diffuse albedo; may exceed 1."""
    share = fitted_tables(shading).albedo(piece.picture("specular"), piece.picture("roughness"))
    return piece.picture("diffuse") * share


def specular_colour(piece: MapRows, shading: TargetShading) -> Picture:
    """(H, W[, 3]) F0 that the target renders as the maps' F0; may exceed 1."""
    return fitted_tables(shading).f0(piece.picture("specular"), piece.picture("roughness"))


def brightest(job: ExportJob, shading: TargetShading) -> float:
    """Largest specular_colour of the maps."""
    peaks = (specular_colour(piece, shading).max() for piece in _bands(job))
    return max(1e-4, *(float(one) for one in peaks), 0.0)


def clipping_notes(job: ExportJob, shading: TargetShading) -> tuple[str, ...]:
    """Note on texels whose base colour exceeds 1."""
    bands = _bands(job)
    over = sum(int((base_colour(piece, shading).max(axis=-1) > 1.0).sum()) for piece in bands)
    if not over:
        return ()
    width, height = job.maps.size
    return (
        f"{100.0 * over / (width * height):.2f} % of the texels reflect more than a layered model "
        "allows; their base colour is clipped",
    )


def _bands(job: ExportJob) -> list[MapRows]:
    _, height = job.maps.size
    return [job.piece(rows) for rows in bands(height)]
