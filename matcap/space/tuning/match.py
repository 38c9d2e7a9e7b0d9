"""Matching: corrects mean and contrast of a fine-tuned material to those of the photograph.

Fine-tuning ends with too little contrast where it does not reproduce the structure, and possibly
with a wrong mean (docs/notes/prior.md). Mean and deviation of every map are parameters of the last
AdaIN. They are corrected by rendering the material as the whole photograph, comparing, and
updating, _ROUNDS times. Diffuse albedo and height share one gain, because the photograph
determines their contrast only jointly; F0 and roughness are not changed.

The contrast ratio is measured by the mean over blocks and by their median; the gain is the ratio
nearest to 1 between both. Scratches or clouds raise the mean only, and a global gain would not
reproduce them.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.material import Material, lacking
from matcap.flash.geometry import plane_points
from matcap.flash.plane import Plane
from matcap.flash.render import render_flash
from matcap.space.decoder import OUTPUTS
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.windows import shot_deviation
from matcap.statistics.encoding import shading

# Matching; docs/notes/prior.md.
_ROUNDS = 3  # iterations
_BLOCK = 32  # texels: side of the blocks over which radiance is averaged
_CLIPPED = 0.97  # share of the clip level above which texels are not compared
_LEAST_SEEN = 0.05  # least share of texels to compare
_DAMPING = 0.1  # added to the squared diffuse share; it limits shifts where most light is specular
_GAIN_STEP = (0.7, 1.4)  # limits of the gain in one iteration
_GAIN = (0.6, 1.7)  # limits of the whole gain
_SHIFT = 1.0  # limit of the whole shift, logits of diffuse albedo

_LOGIT_EPSILON = 1e-5  # of albedo: bounds the logit at 0 and 1
_DIFFUSE, _HEIGHT = slice(0, 3), slice(5, 6)  # of the raw outputs


@dataclass(frozen=True)
class Correction:
    """Correction of mean and contrast."""

    gain: float
    """Factor on the deviations of diffuse albedo, in logits, and of height."""
    shift: Tensor
    """(3,) added to the mean of diffuse albedo, in logits."""


def match_photograph(material: Material, plane: Plane, seed: int = 0) -> Material:
    """Correct a material's mean and contrast to those of the photograph.

    Args:
        material: fine-tuned to the photograph.
        plane: the photograph; its noise, if known, is added to the rendering.
        seed: of the realisation that is compared.

    Raises:
        UsageError: the material has no decoder.
    """
    step = correction(material, plane, seed)
    tuned = _tuned(material)
    decoder = copy.deepcopy(tuned.decoder)
    affine = decoder.head.adain.affine
    with torch.no_grad():
        mean, deviation = affine.bias.split(OUTPUTS)
        _, slope = affine.weight.split(OUTPUTS)
        mean[_DIFFUSE] += step.shift
        for rows in (_DIFFUSE, _HEIGHT):
            deviation[rows] *= step.gain
            slope[rows] *= step.gain
    return replace(material, generators={"decoder": replace(tuned, decoder=decoder)})


def correction(material: Material, plane: Plane, seed: int) -> Correction:
    """The correction that match_photograph applies.

    Identity where less than _LEAST_SEEN of the photograph can be compared.
    """
    width, height = plane.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    true = plane.encoding.log(plane.linear[None])
    contrast = _contrast(true)
    hiss = None if plane.noise is None else plane.noise / shot_deviation(plane.linear)
    with torch.inference_mode():
        tuned = _tuned(material)
        middle, _ = tuned.decoder.head.adain.target(tuned.code)
        maps = material.maps(width, height, seed=seed)
        logit = torch.logit(maps.diffuse, eps=_LOGIT_EPSILON)
        moved, share = Correction(1.0, torch.zeros(3)), None
        for _ in range(_ROUNDS):
            now = _moved(maps, logit, middle[_DIFFUSE], moved)
            clean = render_flash(now, material.setup, points)
            if share is None:
                share = _diffuse_share(now, clean, material, points)
            seen = clean if hiss is None else clean + hiss * shot_deviation(clean)
            bright = torch.maximum(plane.linear.amax(0), seen.amax(0))
            compared = plane.valid & (bright < _CLIPPED * plane.encoding.limit)
            if float(compared.float().mean()) < _LEAST_SEEN:
                break
            log = plane.encoding.log(seen[None])
            blocks = _Blocks(compared)
            moved = Correction(
                _bounded(moved.gain * _gain(contrast, _contrast(log), blocks), _GAIN),
                _shift((true - log)[0], share, moved.shift, blocks).clamp(-_SHIFT, _SHIFT),
            )
    return moved


def _tuned(material: Material) -> TunedDecoder:
    tuned = material.part(TunedDecoder)
    if tuned is None:
        raise lacking("decoder")
    return tuned


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


def _moved(maps: MapSet, logit: Tensor, middle: Tensor, by: Correction) -> MapSet:
    """Apply a correction to maps; `logit` and `middle` are logits of diffuse albedo, their mean."""
    middle, shift = middle[:, None, None], by.shift[:, None, None]
    diffuse = torch.sigmoid(middle + shift + by.gain * (logit - middle))
    return replace(maps, diffuse=diffuse, height=by.gain * maps.height)


def _contrast(log: Tensor) -> Tensor:
    """(3, H, W) squared difference of log radiance (1, 3, H, W) from its shading."""
    return (log - shading(log))[0].square()


def _diffuse_share(maps: MapSet, rendered: Tensor, material: Material, points: Tensor) -> Tensor:
    """(3, H, W) derivative of log radiance by the logit of diffuse albedo, in [0, 1]."""
    black = replace(maps, diffuse=torch.zeros_like(maps.diffuse))
    glossy = render_flash(black, material.setup, points)
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
