"""Range check of light intensities for single precision."""

from __future__ import annotations

from collections.abc import Sequence

from matcap.errors import MatcapError
from matcap.relight.scene import (
    Colour,
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
)

# Squares of larger numbers overflow float32. The sun's luminance is 2e9 cd/m2.
BRIGHTEST = 1e18


def check_lights(lights: Sequence[Light]) -> None:
    """Refuse lights above BRIGHTEST.

    Raises:
        MatcapError: with the light's number and type.
    """
    for index, light in enumerate(lights):
        if max(_colour(light)) > BRIGHTEST:
            raise too_bright(lights, index)


def too_bright(lights: Sequence[Light], index: int | None = None) -> MatcapError:
    """The error that names a light: `index`, or the brightest where a picture has overflowed."""
    if index is None:
        index = max(range(len(lights)), key=lambda i: max(_colour(lights[i])))
    light = lights[index]
    kind = type(light).__name__.removesuffix("Light").lower()
    return MatcapError(
        f"{max(_colour(light)):.2g} is too bright for single precision",
        where=f"light {index + 1} ({kind})",
        remedy="give it less, or more distance, and let the film's exposure make up for it",
    )


def _colour(light: Light) -> Colour:
    if isinstance(light, PointLight):
        return light.intensity
    if isinstance(light, DirectionalLight):
        return light.irradiance
    if isinstance(light, EnvironmentLight) and light.file is not None:
        return (light.scale,) * 3
    return light.radiance
