"""From a photograph on its plane to the exemplar: the maps of the photographed piece.

The network reads the whole picture; what the photograph says outright of relief's strength holds
its answer to the truth; levels and texels are then moved until the maps re-render to the
photograph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.coarse import CoarseFit
from matcap.capture.exemplar.adapt import adapt
from matcap.capture.exemplar.contrast import even_contrast
from matcap.capture.exemplar.equalise import equalise
from matcap.capture.exemplar.refine import Light, flatten, level, refine, remaining
from matcap.capture.exemplar.smooth import smoothed
from matcap.capture.exemplar.strengths import Strengths
from matcap.capture.exemplar.told import noise_level, plane_strengths
from matcap.capture.exemplar.transport import transport
from matcap.capture.finetune import TuneScene
from matcap.flash.geometry import plane_points
from matcap.flash.plane import Plane
from matcap.flash.rectify import inside
from matcap.model.example.example import Example
from matcap.model.exemplar import Exemplar
from matcap.model.inverse.inputs import network_inputs, true_outputs
from matcap.model.inverse.network import GLOSS, OUTPUTS, Inverse

# Expected errors at which confidence has fallen to 1/e: log albedo, log F0, logit roughness, slope.
_DOUBTED = (0.3, 0.6, 0.6, 0.15)
_LEAST_NOISE = 0.01  # of log radiance: what is not explained, where the sensor's is less
# Legs of adaptation and how far each reaches; in between, what relief no longer explains goes back
# to albedo. Short steps at the end: long ones stray by a tenth of relief's strength.
_LEGS = (1.0, 0.35)
_TRIED, _TRIED_AT_ONCE = 250, 40  # blocks for a place under glare: adapted, or at once
_AROUND = 12.0  # the long side over the deviation of a neighbourhood's confidence
# Where a neighbourhood (deviation in texels) has less light than this, of 1 at clipping, a
# photograph of 8 bits has its last codes, and a RAW the sensor's noise.
_UNLIT, _UNLIT_AROUND = 1e-3, 8.0


@dataclass(frozen=True)
class FoundExemplar:
    """The exemplar and how it was found.

    Attributes:
        example: the maps, indexed to be rearranged.
        strengths: what the photograph says of relief and albedo outright, or None.
        error: median difference of log radiance between photograph and re-rendering, of texels
            seen and not clipped.
        slow: mean size of its part that varies slowly, which is not the material's.
        interrupted: adaptation was ended by Ctrl-C.
    """

    example: Example
    strengths: Strengths | None
    error: float
    slow: float
    interrupted: bool = False

    @property
    def exemplar(self) -> Exemplar:
        """The maps."""
        return self.example.exemplar


@torch.no_grad()
def find_exemplar(
    plane: Plane,
    coarse: CoarseFit,
    network: Inverse,
    scene: TuneScene | None = None,
    *,
    steps: int = 0,
    seconds: float | None = None,
    seed: int = 0,
    tell: Callable[[float], None] | None = None,
) -> FoundExemplar:
    """Maps of the photographed piece.

    Args:
        plane: the photograph.
        coarse: its coarse fit.
        network: reads it (store.load_inverse).
        scene: the photograph's statistics and order; without them the piece is not adapted.
        steps: of adaptation.
        seconds: of adaptation at most, or None.
        seed: of adaptation.
        tell: called as adaptation goes on with the share that is done.
    """
    width, height = plane.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    # What lies beyond the photograph is its mirror, not glare.
    beyond = torch.from_numpy(~inside((height, width), coarse.setup))
    shown = plane.valid | beyond
    inputs = network_inputs(plane.linear, shown, coarse, points)
    bright = lit(plane.linear)
    shown, plane = shown & bright, replace(plane, valid=plane.valid & bright)
    answer = _read(network, inputs)
    found, errors = answer[:OUTPUTS].clone(), answer[OUTPUTS:]
    light = Light(coarse, points)
    noise = noise_level(plane)
    strengths = plane_strengths(plane, inputs, light.shows_relief(light.maps(found)))
    found[5] = torch.from_numpy(equalise(found[5].numpy(), strengths))
    trusted = confidence(errors, plane.valid)
    glare = inputs[GLOSS].clamp(0.0, 1.0).numpy()
    trusted[0] *= 1.0 - glare

    def even(outputs: Tensor) -> Tensor:
        return flatten(outputs, torch.from_numpy(trusted), glare)

    def explained(outputs: Tensor) -> Tensor:
        least = max(noise, _LEAST_NOISE)
        refined = refine(outputs, errors, plane.linear, shown, light, noise=least)
        return even(refined.outputs)

    outputs = explained(level(even(found), plane.linear, shown, light))
    interrupted = False
    for leg, reach in enumerate(_LEGS):
        if scene is None or not steps or interrupted:
            break
        albedo = even_contrast(outputs[:3].numpy(), np.square(trusted[0]))
        adapted = adapt(
            light.maps(torch.cat([torch.from_numpy(albedo), outputs[3:]]), plane.texel_size),
            plane.valid.numpy(),
            scene,
            -(-steps // len(_LEGS)),
            reach=reach,
            seconds=None if seconds is None else seconds / len(_LEGS),
            seed=seed * len(_LEGS) + leg,
            tell=tell and _shared(tell, leg),
        )
        interrupted = adapted.interrupted
        outputs = explained(true_outputs(adapted.maps, coarse))
    maps = light.maps(outputs, plane.texel_size)
    refined = remaining(outputs, plane.linear, plane.valid, light)
    exemplar = Exemplar(
        diffuse=maps.diffuse.numpy(),
        specular=maps.specular.numpy(),
        roughness=maps.roughness.numpy(),
        height=maps.height.numpy(),
        confidence=trusted,
        texel_size=plane.texel_size,
    )
    tried = _TRIED if steps else _TRIED_AT_ONCE
    whole = transport(exemplar, plane.linear, plane.valid, light, tried=tried)
    seen = refined.residual[:, plane.valid]
    order = tuple((wave.fx, wave.fy) for wave in scene.waves) if scene else ()
    return FoundExemplar(
        example=Example.of(whole, order),
        strengths=strengths,
        error=float(seen.abs().median()) if seen.numel() else 0.0,
        slow=float(refined.slow.abs().mean()),
        interrupted=interrupted,
    )


def _shared(tell: Callable[[float], None], leg: int) -> Callable[[float], None]:
    """Tells of one leg's share as part of all."""
    return lambda share: tell((leg + share) / len(_LEGS))


def piece_maps(exemplar: Exemplar) -> MapSet:
    """The photographed piece as a map set."""
    stacked = torch.from_numpy(exemplar.stacked())
    return MapSet.from_stacked(stacked, exemplar.texel_size)


def confidence(errors: Tensor, valid: Tensor) -> NDArray[np.float32]:
    """(4, H, W) in [0, 1] of expected errors (4, H, W), logarithms; 0 where nothing was seen.

    Of neighbourhoods: confidence is about where the light shows a map, not about which of the
    material's features are easily read, or only its plain places would be believed.
    """
    doubt = errors.clamp(-8.0, 4.0).exp().numpy() / np.array(_DOUBTED, np.float32)[:, None, None]
    around = max(valid.shape) / _AROUND
    believed = np.stack([np.exp(-smoothed(plane, around)) for plane in doubt])
    # What a clipped texel's neighbours hold is partly its own.
    seen = cv2.erode(valid.numpy().astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.ascontiguousarray(believed * seen, dtype=np.float32)


def lit(linear: Tensor) -> Tensor:
    """(H, W) bool: where radiance (3, H, W) tells anything, and is not black all around."""
    return torch.from_numpy(smoothed(linear.mean(0).numpy(), _UNLIT_AROUND) > _UNLIT)


def _read(network: Inverse, inputs: Tensor) -> Tensor:
    """(OUTPUTS + ERRORS, H, W) of a picture of any size."""
    height, width = inputs.shape[-2:]
    multiple = network.config.multiple
    pad = (0, -width % multiple, 0, -height % multiple)
    mode = "reflect" if max(pad[1], pad[3]) < min(height, width) else "replicate"
    whole = F.pad(inputs[None], pad, mode=mode) if any(pad) else inputs[None]
    answer: Tensor = network(whole.contiguous(memory_format=torch.channels_last))
    return answer[0, :, :height, :width]
