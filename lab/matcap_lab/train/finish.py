"""Finishing a trained state: a prior of its networks and the photographs it was trained on.

The aggregate posterior of all training codes is shifted and scaled to zero mean and unit variance,
dimension by dimension. Encoder and decoder absorb the change exactly, so that reconstructions are
unchanged and standard normal draws match the codes' distribution.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from matcap.flash.alignment import picture
from matcap.flash.rectify import rectify
from matcap.space.decoder import CODE_SIZE, Decoder
from matcap.space.encoder import Encoder, describe_windows, numbers, texture
from matcap.space.prior.store import (
    VARYING,
    Anchor,
    Anchors,
    ConditionalMean,
    Prior,
    base_of,
    varying,
)
from matcap_lab.train.corpus import WAVE_DETAIL, Entry

_RIDGE = 10.0  # of the regression: weighs as much as so many photographs
DEAD = 0.05  # variance of the codes' means below which a dimension is unused


@dataclass(frozen=True)
class Codes:
    """Codes of photographs: means and variances, (N, CODE_SIZE) each."""

    mean: Tensor
    variance: Tensor

    @property
    def aggregate(self) -> tuple[Tensor, Tensor]:
        """Mean and variance per dimension of codes drawn for all the photographs."""
        spread = self.mean.var(dim=0, correction=0)
        return self.mean.mean(0), spread + self.variance.mean(0)

    def standardised(self) -> Codes:
        """The same codes after standardise()."""
        mean, variance = self.aggregate
        return Codes((self.mean - mean) / variance.sqrt(), self.variance / variance)


def codes_of(encoder: Encoder, entries: Sequence[Entry]) -> Codes:
    """Encode photographs of the pack."""
    means, variances = [], []
    for entry in entries:
        photo = entry.photo()
        linear, valid = rectify(photo, entry.coarse.setup, WAVE_DETAIL)
        with torch.inference_mode():
            mean, log_variance = encoder(
                picture(photo.pixels, encoder.config.width)[None],
                numbers(entry.coarse, entry.contrast, WAVE_DETAIL)[None],
                texture(describe_windows(linear, valid))[None],
            )
        means.append(mean[0])
        variances.append(log_variance[0].exp())
    return Codes(torch.stack(means), torch.stack(variances))


def standardise(encoder: Encoder, decoder: Decoder, codes: Codes) -> tuple[Encoder, Decoder]:
    """Copies with codes z' = (z - mean) / deviation and the same pictures.

    The encoder's bounds of log variances are not shifted with them, so a clamped one may differ.
    """
    mean, variance = codes.aggregate
    deviation = variance.sqrt()
    encoder, decoder = copy.deepcopy(encoder), copy.deepcopy(decoder)
    with torch.no_grad():
        head = encoder.head
        head.weight[:CODE_SIZE] /= deviation[:, None]
        head.bias[:CODE_SIZE] = (head.bias[:CODE_SIZE] - mean) / deviation
        head.bias[CODE_SIZE:] -= 2.0 * deviation.log()
        for layer in decoder.layers():
            affine = layer.adain.affine
            affine.bias.add_(affine.weight @ mean)
            affine.weight.mul_(deviation)
    return encoder, decoder


def conditional_mean_of(codes: Codes, entries: Sequence[Entry]) -> ConditionalMean:
    """Ridge regression of bases on standardised codes, and the covariance of the residuals."""
    bases = torch.stack([varying(base_of(e.coarse, e.contrast)) for e in entries]).double()
    offset = bases.mean(0)
    code = codes.mean.double()
    normal = code.T @ code + _RIDGE * torch.eye(CODE_SIZE)
    matrix = torch.linalg.solve(normal, code.T @ (bases - offset)).T
    rest = bases - offset - code @ matrix.T
    covariance = rest.T @ rest / len(rest) + 1e-6 * torch.eye(VARYING)
    return ConditionalMean(
        matrix.float(), offset.float(), torch.linalg.cholesky(covariance).float()
    )


def finish(
    encoder: Encoder, decoder: Decoder, entries: Sequence[Entry], about: Mapping[str, Any]
) -> Prior:
    """A prior from trained networks and the photographs they were trained on."""
    codes = codes_of(encoder, entries)
    encoder, decoder = standardise(encoder, decoder, codes)
    codes = codes.standardised()
    mean, variance = codes.aggregate
    informative = codes.mean.var(dim=0, correction=0)
    measured = {
        "code_mean": [round(v, 3) for v in mean.tolist()],
        "code_variance": [round(v, 3) for v in variance.tolist()],
        "dead_dimensions": int((informative < DEAD).sum()),
    }
    model = conditional_mean_of(codes, entries)
    return Prior(
        encoder, decoder, model, anchors_known(codes, model, entries), {**about, **measured}
    )


def anchors_known(codes: Codes, model: ConditionalMean, entries: Sequence[Entry]) -> Anchors:
    """Anchors of a prior: latent codes and bases of photographs."""
    return anchors_of(
        [
            Anchor(code, model.rest(code, base_of(entry.coarse, entry.contrast)), entry.waves)
            for code, entry in zip(codes.mean, entries, strict=True)
        ]
    )


def with_anchors(prior: Prior, entries: Sequence[Entry]) -> Prior:
    """A prior whose draws are near these photographs; its networks are unchanged."""
    codes = codes_of(prior.encoder, entries)
    return replace(prior, anchors=anchors_known(codes, prior.conditional_mean, entries))


def anchors_of(places: Sequence[Anchor]) -> Anchors:
    """Stack several anchors."""
    waves = torch.zeros(len(places), 2, 2)
    for row, place in zip(waves, places, strict=True):
        for slot, wave in zip(row, place.waves, strict=False):
            slot.copy_(torch.tensor(wave))
    codes = torch.stack([place.code for place in places])
    return Anchors(codes, torch.stack([place.rest for place in places]), waves)
