"""What a tolerance of relighting costs, and what error it leaves: time against accuracy.

Each scene is rendered at several tolerances, with all effects, and with diffuse light alone. Errors
are the largest differences of codes from all effects at a 16th of the default tolerance, which
also mirrors surroundings in more directions. Times are of the processor, horizons included, and
told as shares of what all effects take in the same run.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.files.srgb import srgb_encode
from matcap.files.staging import check_writable
from matcap.lab.bench.plot import draw
from matcap.lab.bench.relight import chosen_scenes, leather, median_seconds
from matcap.lab.bench.table import Measurement, append, front, machine, points
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.render import Renderer
from matcap.relight.scene import Film, Scene

# Of the plan, in steps of 8 bits; the default is half of one.
TOLERANCES = (0.03, 0.125, 0.5, 2.0, 8.0, 32.0)
_STEP = 1.0 / 255.0
_EVERYTHING = "all effects"
_FINE = 16.0  # the reference's tolerance is the default's so many-eth part

# How each point is rendered: its group, its effects, its tolerance in steps.
_POINTS: Mapping[str, tuple[str, str, float]] = {
    **{f"{steps:g} steps": ("tolerance", "auto", steps) for steps in TOLERANCES},
    _EVERYTHING: ("effects", "all", 0.5),
    "diffuse alone": ("effects", "none,+diffuse,+falloff", 0.5),
}


def measure_tolerances(
    scenes: Sequence[Path],
    *,
    width: int = 256,
    texels: int = 512,
    repeats: int = 3,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[Measurement]:
    """Every scene, at every point.

    Args:
        scenes: see chosen_scenes().
        width: of the pictures.
        texels: across the leather that is lit.
        repeats: of which the median counts.
        tell: hears of every measurement.
    """
    texture, by = leather(texels), machine()
    measured = []
    for name, given in chosen_scenes(scenes):
        film = given.film or Film()
        film = replace(film, width=width, height=max(1, round(width * film.height / film.width)))
        scene = replace(given, film=film)
        fine = DEFAULT_TOLERANCE / _FINE
        true = Renderer(texture, scene).render(tolerance=fine, effects="all").radiance
        for point, (group, effects, steps) in _POINTS.items():

            def render(
                scene: Scene = scene, effects: str = effects, steps: float = steps
            ) -> NDArray[np.float32]:
                renderer = Renderer(texture, scene)
                return renderer.render(tolerance=steps * _STEP, effects=effects).radiance

            error = float(np.abs(_codes(render(), film) - _codes(true, film)).max()) / _STEP
            seconds = median_seconds(render, repeats)
            measured.append(
                Measurement("relight", group, point, name, seconds, float("nan"), error, machine=by)
            )
            tell(f"{name}: {point}, {seconds:.3f} s, {error:.2f} steps off")
    return measured


def write_tolerances(measured: Sequence[Measurement], folder: Path) -> None:
    """Write relight.csv and relight.png, the front in the picture.

    Raises:
        MatcapError: matplotlib is not installed, or the folder cannot be written.
    """
    check_writable(folder, 1_000_000)
    table = folder / "relight.csv"
    table.unlink(missing_ok=True)
    for one in measured:
        append(table, one)
    draw(
        points(measured),
        folder / "relight.png",
        title="relighting: largest difference from all effects, mean of the scenes",
        error="8-bit steps",
        least=0.01,
    )


def tolerances_markdown(measured: Sequence[Measurement], command: str) -> str:
    """The points as a section of documentation, fastest first; those on the front have a star."""
    found = points(measured)
    best = {point.name for point in front(found)}
    seconds = {(one.point, one.subject): one.seconds for one in measured}
    lines = [
        "Measured by:",
        "",
        f"    {command}",
        "",
        f"On {measured[0].machine}.",
        "",
        "| | | scenes | seconds | of all effects' time, median | steps off, mean | at most |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for point in sorted(found, key=lambda point: point.seconds):
        of = [one for one in measured if one.point == point.name]
        shares = [one.seconds / seconds[_EVERYTHING, one.subject] for one in of]
        lines.append(
            f"| {'*' if point.name in best else ''} | {point.name} | {point.subjects} "
            f"| {point.seconds:.3f} | {statistics.median(shares):.2f} | {point.error:.2f} "
            f"| {max(one.error for one in of):.2f} |"
        )
    return "\n".join(lines) + "\n"


def _codes(radiance: NDArray[np.float32], film: Film) -> NDArray[np.float64]:
    """Codes of the film, not clipped above, so that nothing hides."""
    light = radiance.astype(np.float64) * film.gain
    return light if film.transfer == "linear" else srgb_encode(light)
