"""How far relit pictures are from Mitsuba 3's, stored in references/.

    python tests/relight/reference_errors.py

prints the tables of docs/notes/relighting.md: root mean square and largest difference, relative to
the reference's mean, of flat maps; and the root mean square on an embossed bright material as
effects are switched on.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from reference_scenes import LIGHTS, embossed_maps, embossed_scene, flat_maps, flat_scene, sky_scene

from matcap.api import relight
from matcap.files.exr import read_exr
from matcap.relight.effects import DEFAULT_TOLERANCE

FOLDER = Path(__file__).parent / "references"
# Mitsuba's material here reflects once: the compensation for more is left out.
SINGLE = "all,-multiscatter"
STAGES = ("flat direct light", "parallax", "shadows", "interreflection")


def reference(name: str) -> np.ndarray:
    return read_exr(FOLDER / f"{name}.exr").pixels


def errors(found: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest, relative to the reference's mean."""
    difference = np.abs(found - expected) / expected.mean()
    return float(np.sqrt((difference**2).mean())), float(difference.max())


def lit(name: str) -> np.ndarray:
    """Flat maps under one of LIGHTS."""
    return relight(flat_maps(), flat_scene(LIGHTS[name]), effects=SINGLE)


def surrounded(finer: float) -> np.ndarray:
    """Flat maps under a sky, at a tolerance so many times finer than the default."""
    scene = sky_scene(FOLDER / "surroundings.exr")
    return relight(flat_maps(), scene, effects=SINGLE, tolerance=DEFAULT_TOLERANCE / finer)


def embossed() -> Iterator[tuple[float, np.ndarray]]:
    """Of each of STAGES the root mean square and the picture.

    Against a path-traced mesh, direct light and one bounce; its pixels are averages, ours points.
    """
    truth = reference("embossed_bounce")
    effects = "none,+diffuse,+specular,+falloff"
    for effect in ("", *(f",+{stage}" for stage in STAGES[1:])):
        effects += effect
        found = relight(embossed_maps(), embossed_scene(), effects=effects)
        yield float(np.sqrt(((found - truth)[1:-1, 1:-1] ** 2).mean()) / truth.mean()), found


def main() -> None:
    rows = [(name, *errors(lit(name), reference(name))) for name in LIGHTS]
    rows += [
        (f"sky, tolerance / {finer:g}", *errors(surrounded(finer), reference("sky")))
        for finer in (1.0, 16.0)
    ]
    print(f"{'flat maps':<24}{'rms':>10}{'largest':>10}")
    for name, rms, largest in rows:
        print(f"{name:<24}{rms:>10.1e}{largest:>10.1e}")
    print(f"\n{'embossed, rms with':<24}")
    for stage, (rms, _) in zip(STAGES, embossed(), strict=True):
        print(f"{stage:<24}{rms:>10.3f}")


if __name__ == "__main__":
    main()
