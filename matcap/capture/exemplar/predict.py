"""Stage network: the network's prediction of the maps, with expected errors and confidence.

In comes an observation (observation.py), out go residuals of log parameters from the coarse fit
(network/network.py), averaged over four shifts, their expected errors e, and the confidence

    visibility * blur(exp(-e / unit)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import SurfaceParameters
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.material_classes import Classes, has_metal, tinted
from matcap.capture.exemplar.network.network import ExpectedErrors, Inverse, NetworkAnswer
from matcap.capture.exemplar.observation import Observation, seen_share
from matcap.capture.exemplar.relief_spectrum import WIDE, smoothed
from matcap.example.exemplar import Exemplar

# Expected errors (log, log, logit, slope) at which confidence is 1/e. Larger values trust
# uncertain maps.
_DOUBTED = (0.3, 0.6, 0.6, 0.15)


@dataclass(frozen=True)
class NetworkPrediction:
    """Maps between stages, as log-parameter residuals from the coarse fit."""

    residuals: SurfaceParameters
    """Residuals of the maps from the coarse fit."""
    errors: ExpectedErrors
    """The network's expected errors."""
    confidence: NDArray[np.float32]
    """(4, H, W) confidence of diffuse, specular, roughness and height, in [0, 1]."""
    logit: Tensor | None
    """(1, H, W) predicted logit of metal; None if it predicts hardly any."""
    classes: Classes
    """Material classes of the texels; one class before `classified`."""

    @property
    def metal(self) -> NDArray[np.float32]:
        """(H, W) share of metal in each texel."""
        return np.asarray(self.classes.metal_share[0].numpy(), np.float32)


def predict_maps(observed: Observation, network: Inverse) -> tuple[Observation, NetworkPrediction]:
    """Predict the maps; the observation's light gets the specular tint of metal."""
    answer = NetworkAnswer.from_stacked(_shift_averaged(network, observed.inputs.stacked()))
    confidence = confidence_of(
        answer.errors, seen_share(observed.plane.measured), observed.plane.unit
    )
    confidence[0] *= 1.0 - observed.specular_fraction
    classes = Classes.whole(observed.specular_fraction.shape, metal=observed.coarse.conductor)
    if observed.coarse.conductor:
        observed = tinted(observed, classes.metal_share)
    mixed = has_metal(answer.metal) and not observed.coarse.by_hand
    logit = answer.metal if mixed else None
    return observed, NetworkPrediction(answer.residuals, answer.errors, confidence, logit, classes)


def exemplar_of(observed: Observation, prediction: NetworkPrediction) -> Exemplar:
    """The maps and their confidence."""
    maps = observed.light.maps(prediction.residuals, observed.plane.texel_size)
    return with_confidence(maps, prediction.confidence)


def with_confidence(maps: MapSet, confidence: NDArray[np.float32]) -> Exemplar:
    """The exemplar of maps and a confidence (4, H, W)."""
    return Exemplar(
        maps.diffuse.numpy(),
        maps.specular.numpy(),
        maps.roughness.numpy(),
        maps.height.numpy(),
        confidence,
        maps.texel_size,
    )


def confidence_of(
    errors: ExpectedErrors, seen: NDArray[np.float32], unit: float
) -> NDArray[np.float32]:
    """(4, H, W) confidence in [0, 1]: visibility times a blur of exp(-error / unit).

    The blur keeps where the light shows a map, and removes which features are predicted easily.

    Args:
        errors: expected errors by map; units are _DOUBTED.
        seen: (H, W) visibility, in [0, 1].
        unit: texels along the photograph's long side.
    """
    error = errors.stacked().clamp(-8.0, 4.0).exp().numpy()
    error = error / np.array(_DOUBTED, np.float32)[:, None, None]
    certain = np.stack([np.exp(-smoothed(plane, unit / WIDE)) for plane in error])
    return np.ascontiguousarray(certain * seen, dtype=np.float32)


def _shift_averaged(network: Inverse, inputs: Tensor) -> Tensor:
    """(ANSWERS, H, W) prediction for inputs (C, H, W) of any size.

    Averaged over the four shifts of the network's grid of 2 x 2 texels, against periodic artefacts.
    """
    height, width = inputs.shape[-2:]
    multiple = network.config.multiple
    right, below = multiple - 1, multiple - 1
    mode = "reflect" if multiple < min(height, width) else "replicate"
    whole = F.pad(inputs[None], (1, right, 1, below), mode=mode)
    whole = whole.contiguous(memory_format=torch.channels_last)
    total: Tensor | float = 0.0
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        rows, columns = (
            -(-(n + by) // multiple) * multiple for n, by in ((height, down), (width, across))
        )
        part = whole[:, :, 1 - down :, 1 - across :][..., :rows, :columns]
        answer: Tensor = network(part.contiguous(memory_format=torch.channels_last))
        total = answer[0, :, down : down + height, across : across + width] + total
    assert isinstance(total, Tensor)
    return total / 4.0
