"""White glints of a coloured dielectric, taken off a photograph before albedo is fitted to it.

One round lobe does not explain the glints of grooves along a streak of light, which would become
white dashes of albedo. In the dichromatic model [shafer1985] radiance over the irradiance E of a
white surface, less the uniform material's specular part, is

    g a + t

in each channel, with the albedo a of the coarse fit, the lightness g of a texel, and t of the
flash's colour: whiteness by albedo itself, or a glint. A sample is stationary, so that the whitest
texels of its matte part bound the whiteness by albedo, and what exceeds it is a glint where so
many texels do that it is not a rare mark. Grey materials do not show it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.exemplar.network.network import SUBSAMPLING, resized
from matcap.capture.exemplar.octaves import local_mean
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import points_of
from matcap.flash.light import FlashLight, uniform_radiance
from matcap.flash.rectify import Plane

Floats = NDArray[np.float32]

_GREYEST = 0.6  # largest ratio of the least channel of albedo to the largest
# The long side over standard deviations: of the local mean of whiteness, as larger white spots are
# no glints, and of the neighbourhood in which they are many.
_AROUND, _MANY_WITHIN = 96.0, 24.0
_RARE = 1e-3  # share of matte texels that are whiter than the bound
_FEW = 10.0  # times that share, in a neighbourhood, up to which white texels are rare marks
_LEAST_LIGHTNESS = 0.05
_LEAST_BOUND = 0.1  # of whiteness, over albedo


@torch.no_grad()
def without_glints(plane: Plane, uniform: CoarseFit, *, metal: bool = False) -> Plane:
    """A photograph less its white glints; unchanged of grey materials and where any is metal."""
    albedo = np.array(uniform.diffuse)
    most, least = int(albedo.argmax()), int(albedo.argmin())
    seen = (plane.measured.all(0) & plane.kept).numpy()
    if metal or uniform.conductor or albedo[least] > _GREYEST * albedo[most] or not seen.any():
        return plane
    height, width = seen.shape
    size = tuple(max(2, -(-side // SUBSAMPLING)) for side in (height, width))
    light = FlashLight.of(uniform.setup, resized(points_of((height, width)), size))
    radiance, diffuse = (
        resized(each, (height, width)) for each in uniform_radiance(uniform, light)
    )
    white = diffuse / torch.tensor(uniform.diffuse)[:, None, None]
    matte_part = (plane.linear - (radiance - diffuse)) / white.clamp_min(1e-9)
    fullest, emptiest = matte_part[most].numpy(), matte_part[least].numpy()
    lightness = (fullest - emptiest) / np.float32(albedo[most] - albedo[least])
    weight, side = seen.astype(np.float32), max(height, width)
    glint = emptiest - np.float32(albedo[least]) * lightness
    glint -= local_mean(glint, weight, side / _AROUND)
    scale = np.maximum(local_mean(lightness, weight, side / _AROUND), np.float32(_LEAST_LIGHTNESS))
    bound = max(_bound(glint / scale, seen, radiance, diffuse), _LEAST_BOUND * float(albedo.mean()))
    beyond = (glint / scale - bound) * seen
    share = local_mean((beyond > 0.0).astype(np.float32), weight, side / _MANY_WITHIN)
    kept = 1.0 - _FEW * _RARE / np.maximum(share, np.float32(_RARE))
    glint = (beyond * scale * kept.clip(0.0, 1.0)).clip(0.0)
    linear = plane.linear - torch.from_numpy(np.asarray(glint, np.float32)) * white
    return replace(plane, linear=torch.where((linear > 0.0).all(0), linear, plane.linear))


def _bound(
    whiteness: Floats, seen: NDArray[np.bool_], radiance: torch.Tensor, diffuse: torch.Tensor
) -> float:
    """The whiteness that _RARE texels of the matte part exceed, where the most light is."""
    share = (diffuse / radiance.clamp_min(1e-9)).mean(0).numpy()
    matte = seen & (share >= np.median(share[seen]))
    lit = diffuse.mean(0).numpy()
    return float(np.quantile(whiteness[matte & (lit >= np.median(lit[matte]))], 1.0 - _RARE))
