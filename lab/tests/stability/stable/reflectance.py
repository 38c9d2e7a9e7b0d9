"""The reflectance where it is hardest: values and gradients of many draws, float32 against float64.

A case draws materials and directions at random from one corner of the domain. Directions are given
in the normal's own frame, where cosines are inputs; elsewhere float32 has already lost the digits
of a grazing cosine before the reflectance sees it, whatever the formula. One case turns the frame.
The reference takes the same float32 numbers in float64, so an error is the formula's own.

What it leaves out: photographs (photographs.py). domains.py lists them all.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from matcap.brdf.cook_torrance import cook_torrance, normalize
from matcap.brdf.maps import MapSet
from matcap.flash.light import shade
from stable.edges.swept import Domain, Swept

SMOOTH = 0.03  # roughness below which the looser bound holds
_CHUNK = 20_000  # draws at a time
# Errors are relative to the value, or to this much in 1/sr, which nothing shows.
_UNSEEN = 1e-6


@dataclass(frozen=True)
class Draws:
    """Inputs of cook_torrance, (..., 1, N) each."""

    diffuse: Tensor
    specular: Tensor
    roughness: Tensor
    normal: Tensor
    to_light: Tensor
    to_view: Tensor

    def tensors(self) -> tuple[Tensor, ...]:
        """In the order cook_torrance takes them."""
        return tuple(vars(self).values())


Case = Callable[[int, torch.Generator], Draws]


def reflected(case: Case, draws: int = _CHUNK) -> Domain:
    """So many draws of a case a call, in float32 and float64, with gradients."""
    return lambda g: measured(case(draws, _torch(g)))


def _torch(g: np.random.Generator) -> torch.Generator:
    return torch.Generator().manual_seed(int(g.integers(2**31)))


def measured(drawn: Draws) -> Swept:
    """In float32 and float64, with gradients."""
    inputs = [tensor.float().requires_grad_() for tensor in drawn.tensors()]
    value = cook_torrance(*inputs)
    gradients = torch.autograd.grad(value.sum(), inputs)
    with torch.no_grad():
        exact = cook_torrance(*(tensor.detach().double() for tensor in inputs))
    error = ((value.double() - exact).abs() / exact.abs().clamp_min(_UNSEEN)).amax(0).flatten()
    return _swept(value, gradients, error.detach(), inputs[2], lambda at: _words(inputs, at))


def _swept(
    value: Tensor,
    gradients: Sequence[Tensor],
    error: Tensor,
    roughness: Tensor,
    where: Callable[[int], str],
) -> Swept:
    """Values (C, 1, N) with their gradients, and errors (N,) by roughness (1, 1, N)."""
    parts = [torch.isfinite(part).all(dim=0).flatten() for part in (value, *gradients)]
    error = torch.nan_to_num(error, nan=math.inf, posinf=math.inf)
    rough = roughness.detach().flatten() >= SMOOTH
    worst, smooth = (float(error[w].max()) if bool(w.any()) else 0.0 for w in (rough, ~rough))
    broken = int((~torch.stack(parts).all(dim=0)).sum())
    return Swept(len(error), broken, 0, worst, where(int(error.argmax())), smooth)


def _words(inputs: list[Tensor], at: int) -> str:
    _, specular, roughness, normal, light, view = (t.detach().double()[..., 0, at] for t in inputs)
    half = light + view
    length = float(half.norm())
    off = float(torch.linalg.cross(normal, half).norm()) / length if length > 0 else math.nan
    return (
        f"roughness {float(roughness):.2g}, F0 {float(specular.max()):.2g}, "
        f"n.l {float(normal @ light):.2g}, n.v {float(normal @ view):.2g}, sin(n,h) {off:.2g}"
    )


def _uniform(n: int, generator: torch.Generator, low: float = 0.0, high: float = 1.0) -> Tensor:
    return low + (high - low) * torch.rand(1, 1, n, generator=generator, dtype=torch.float64)


def _log_uniform(n: int, generator: torch.Generator, low: float, high: float) -> Tensor:
    return torch.exp(_uniform(n, generator, math.log(low), math.log(high)))


def _direction(cosine: Tensor, generator: torch.Generator) -> Tensor:
    """(3, 1, N) unit vectors at a cosine from the z axis, any azimuth."""
    around = _uniform(cosine.shape[-1], generator, 0.0, 2.0 * math.pi)
    sine = (1.0 - cosine.square()).clamp_min(0.0).sqrt()
    return torch.cat([sine * around.cos(), sine * around.sin(), cosine])


def _anywhere(n: int, g: torch.Generator) -> Draws:
    """Albedos, roughness and directions over the whole hemisphere; cosines of at least 0.01."""
    up = torch.zeros(3, 1, n, dtype=torch.float64)
    up[2] = 1.0
    return Draws(
        diffuse=torch.cat([_uniform(n, g) for _ in range(3)]),
        specular=_uniform(n, g),
        roughness=_uniform(n, g),
        normal=up,
        to_light=_direction(_uniform(n, g, 0.01), g),
        to_view=_direction(_uniform(n, g, 0.01), g),
    )


def _turn(base: Draws, g: torch.Generator) -> Draws:
    """The same in frames turned at random."""
    axis = torch.randn(3, 1, base.roughness.shape[-1], generator=g, dtype=torch.float64)
    z = normalize(axis)
    x = normalize(torch.linalg.cross(z, axis.roll(1, 0) + 0.5, dim=0))
    frame = torch.stack([x, torch.linalg.cross(z, x, dim=0), z], dim=1)  # (3, 3, 1, N)

    def turn(v: Tensor) -> Tensor:
        return torch.einsum("ijkn,jkn->ikn", frame, v)

    return replace(
        base, normal=turn(base.normal), to_light=turn(base.to_light), to_view=turn(base.to_view)
    )


def _near_peak(n: int, g: torch.Generator, roughness: Tensor) -> Draws:
    """Directions whose half vector lies within a few alpha of the normal."""
    base = replace(_anywhere(n, g), roughness=roughness)
    view = _direction(_uniform(n, g, 0.2), g)
    mirrored = view * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)[:, None, None]
    off = roughness.square() * _log_uniform(n, g, 1e-2, 10.0)
    around = _uniform(n, g, 0.0, 2.0 * math.pi)
    shift = torch.cat([off * around.cos(), off * around.sin(), torch.zeros_like(off)])
    return replace(base, to_view=view, to_light=normalize(mirrored + 2.0 * shift))


def _sharp(roughest: float) -> Case:
    """Peaks of roughness from 1e-4."""
    return lambda n, g: _near_peak(n, g, _log_uniform(n, g, 1e-4, roughest))


def _grazing(view: bool, light: bool) -> Case:
    def draw(n: int, g: torch.Generator) -> Draws:
        base = _anywhere(n, g)
        return replace(
            base,
            roughness=_log_uniform(n, g, 1e-4, 1.0),
            to_view=_direction(_log_uniform(n, g, 1e-7, 0.1), g) if view else base.to_view,
            to_light=_direction(_log_uniform(n, g, 1e-7, 0.1), g) if light else base.to_light,
        )

    return draw


def _below(n: int, g: torch.Generator) -> Draws:
    base = _anywhere(n, g)
    return replace(
        base,
        roughness=_log_uniform(n, g, 1e-4, 1.0),
        to_light=_direction(_uniform(n, g, -1.0, 0.0), g),
    )


def _light_is_view(n: int, g: torch.Generator) -> Draws:
    base = _anywhere(n, g)
    view = _direction(1.0 - _log_uniform(n, g, 1e-12, 0.99), g)
    return replace(base, roughness=_log_uniform(n, g, 1e-4, 1.0), to_view=view, to_light=view)


def _opposed(n: int, g: torch.Generator) -> Draws:
    """Light against view across the horizon: the half vector has no length."""
    base = _anywhere(n, g)
    view = _direction(_uniform(n, g, -1e-6, 1e-6), g)
    return replace(base, to_view=view, to_light=-view)


def _constants(
    *,
    diffuse: tuple[float, float, float] | None = None,
    specular: float | tuple[float, float, float] | None = None,
    roughness: float | None = None,
) -> Case:
    def draw(n: int, g: torch.Generator) -> Draws:
        base = _sharp(1.0)(n, g)
        if diffuse is not None:
            colour = torch.tensor(diffuse, dtype=torch.float64)[:, None, None]
            base = replace(base, diffuse=colour.expand(3, 1, n))
        if specular is not None:
            f0 = torch.tensor(specular, dtype=torch.float64).reshape(-1, 1, 1)
            base = replace(base, specular=f0.expand(-1, 1, n))
        if roughness is not None:
            base = replace(base, roughness=torch.full_like(base.roughness, roughness))
        return base

    return draw


# What each is called in the table of docs/notes/stability.md. Where the paper's code fails come
# first.
CASES: Mapping[str, Case] = MappingProxyType(
    {
        "both albedos 0": _constants(diffuse=(0.0, 0.0, 0.0), specular=0.0),
        "red 0, roughness 0": _constants(diffuse=(0.0, 0.5, 0.5), roughness=0.0),
        "F0 = 0": _constants(specular=0.0),
        "F0 = 1": _constants(specular=1.0),
        "F0 1 in red, 0 in blue": _constants(specular=(1.0, 0.5, 0.0)),
        "coloured gloss alone, roughness 0": _constants(
            diffuse=(0.0, 0.0, 0.0), specular=(1.0, 0.5, 0.1), roughness=0.0
        ),
        "roughness 0": _constants(roughness=0.0),
        "roughness 1": _constants(roughness=1.0),
        "the whole hemisphere": _anywhere,
        "the same, frames turned": lambda n, g: _turn(_anywhere(n, g), g),
        "peak, roughness 0.03 to 1": lambda n, g: _near_peak(n, g, _uniform(n, g, SMOOTH, 1.0)),
        "peak, roughness 1e-4 to 0.03": _sharp(SMOOTH),
        "peaks, frames turned": lambda n, g: _turn(_sharp(1.0)(n, g), g),
        "grazing view": _grazing(view=True, light=False),
        "grazing light": _grazing(view=False, light=True),
        "both grazing": _grazing(view=True, light=True),
        "light below the horizon": _below,
        "light at the camera": _light_is_view,
        "light opposed to view": _opposed,
    }
)


def rendered(g: np.random.Generator) -> Swept:
    """As measured_rendering."""
    return measured_rendering(_CHUNK, _torch(g))


def measured_rendering(n: int, g: torch.Generator) -> Swept:
    """The whole flash rendering, slopes and falloff included, with lights from 1e-3 to 1e9 away.

    The light's strength grows with its distance squared, so that what is seen stays visible.
    """
    base, distance = _anywhere(n, g), _log_uniform(n, g, 1e-3, 1e9)
    given = [
        base.diffuse,
        base.specular,
        _log_uniform(n, g, 1e-4, 1.0),
        _log_uniform(n, g, 1e-4, 10.0) * torch.randn(1, 1, n, generator=g, dtype=torch.float64),
    ]
    light = _direction(_uniform(n, g, 0.05), g) * distance
    inputs = [tensor.float().requires_grad_() for tensor in given]

    def radiance(maps: list[Tensor]) -> Tensor:
        kind = maps[0].dtype
        return shade(
            MapSet(*maps, texel_size=1.0),
            torch.zeros(3, 1, n, dtype=kind),
            torch.tensor([0.0, 0.0, 2.4], dtype=kind),
            light.float().to(kind),
            distance.square().float().to(kind).expand(3, 1, n),
        )

    value = radiance(inputs)
    gradients = torch.autograd.grad(value.sum(), inputs)
    exact = radiance([tensor.detach().double() for tensor in inputs])
    # Slopes round before the reflectance sees them, so errors count against the brightest.
    error = (value.detach().double() - exact).abs() / exact.abs().clamp_min(1e-2)
    return _swept(value, gradients, error.amax(0).flatten(), inputs[2], lambda _at: "")
