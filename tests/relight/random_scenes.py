"""Random scenes and materials, and the largest difference that skipping effects makes in them.

`python tests/relight/random_scenes.py 300` tries as many as are asked for and prints the worst.
With `--times 32` it tells how much less processor time the plan takes than all effects, in pictures
of 32 times the width and height: of a few hundred pixels a side.
"""

import random
import statistics
import sys
from dataclasses import replace
from time import process_time

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.files.color import srgb_encode
from matcap.relight.effects import DEFAULT_TOLERANCE
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)


def codes(radiance, film: Film):
    """Film codes of radiance without clipping, so that errors of highlights count."""
    light = radiance.astype(np.float64) * film.gain
    return light if film.transfer == "linear" else srgb_encode(light)


def random_maps(rng: random.Random) -> MapSet:
    """Anything from a flat grey card to an embossed mirror, with the border cases often."""
    width, height = rng.choice([8, 16, 24]), rng.choice([8, 16])
    generator = np.random.default_rng(rng.randrange(2**32))

    def field(low: float, high: float, channels: int = 1) -> torch.Tensor:
        rough = generator.random((channels, height, width))
        return torch.from_numpy(low + (high - low) * rough).float()

    relief = rng.choice([0.0, 0.0, 1e-7, 1e-5, 1e-3, 0.05])
    albedo = rng.choice([0.0, 0.02, 0.9])
    f0 = rng.choice([(0.0, 0.0), (0.04, 0.04), (0.0, 1.0)])
    rough = rng.choice([(1.0, 1.0), (0.6, 0.9), (0.2, 0.5)])
    return MapSet(
        field(0.0, albedo, 3), field(*f0), field(*rough), field(0.0, relief), 2.0 / width, True
    )


def random_scene(rng: random.Random) -> Scene:
    """A small picture of some surface under one to three lights of any strength."""
    film = Film(
        rng.choice([6, 12]), rng.choice([6, 9]), rng.choice([0.0, -2.0, 1.0]),
        rng.choice(["srgb", "linear"]),
    )  # fmt: skip
    kind = rng.choice(["plane", "plane", "plane", "sphere", "cylinder"])
    place = (rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(1.5, 4.0))
    target = (rng.uniform(-0.3, 0.3), 0.0, 0.0)
    camera = rng.choice(
        [
            None,
            Camera(position=place, target=target),
            Camera("orthographic", place, target, scale=rng.uniform(0.3, 1.2)),
        ]
    )
    surface = Surface(
        kind,
        rng.choice([None, 1.0, 2.0]) if kind == "plane" else 1.0,
        rng.choice([0.1, 0.5, 1.0, 3.0]),
        rng.choice([0.0, 0.5, 1.0]),
    )
    lights = tuple(random_light(rng) for _ in range(rng.randint(1, 3)))
    return Scene(film, camera, surface, lights)


def random_light(rng: random.Random):
    strength = 10.0 ** rng.uniform(-6.0, 0.5)
    colour = tuple(strength * rng.random() for _ in range(3))
    far = rng.choice([1.0, 3.0, 1000.0])
    place = tuple(far * c for c in (rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0.3, 1.5)))
    kind = rng.randrange(5)
    if kind == 0:
        return PointLight(place, tuple(far**2 * c for c in colour))
    if kind == 1:
        return DirectionalLight(place, colour)
    size = rng.choice([1e-6, 1e-3, 0.2]) * far
    glow = tuple(c * (far / size) ** 2 for c in colour)
    if kind == 2:
        return SphereLight(place, size, glow)
    if kind == 3:
        return RectangleLight(place, tuple(-c for c in place), (0.3, 1.0, 0.2), (size, size), glow)
    return EnvironmentLight(radiance=colour)


def worst_difference(seed: int) -> tuple[float, int]:
    """Largest difference of codes between plan and everything, and how many effects were off."""
    rng = random.Random(seed)
    maps, scene = random_maps(rng), random_scene(rng)
    renderer = Renderer(maps, scene)
    planned = renderer.render()
    everything = renderer.render(effects="all")
    off = sum(not step.on for step in planned.plan.steps)
    assert np.isfinite(everything.radiance).all()
    film = planned.film
    difference = np.abs(codes(planned.radiance, film) - codes(everything.radiance, film))
    return float(difference.max()), off


def time_ratio(seed: int, larger: int) -> float:
    """Processor time of everything over the plan's, horizons included."""
    rng = random.Random(seed)
    maps, scene = random_maps(rng), random_scene(rng)
    film = scene.film
    film = replace(film, width=larger * film.width, height=larger * film.height)
    times: dict[str, list[float]] = {"all": [], "auto": []}
    # What is made once for a light is made in the first of three, which does not count for either.
    for effects in 3 * ("all", "auto"):
        renderer = Renderer(maps, replace(scene, film=film))
        start = process_time()
        renderer.render(effects=effects)
        times[effects].append(process_time() - start)
    return min(times["all"]) / min(times["auto"])


def times(count: int, larger: int) -> None:
    found = sorted(time_ratio(seed, larger) for seed in range(count))
    low, high = found[count // 10], found[count - 1 - count // 10]
    print(
        f"{count} scenes, {larger} times as large, all effects over the plan: "
        f"median {statistics.median(found):.1f}, "
        f"a tenth below {low:.1f}, a tenth above {high:.1f}, least {found[0]:.2f}"
    )


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    if "--times" in sys.argv:
        times(count, int(sys.argv[sys.argv.index("--times") + 1]))
        return
    worst, skipped = 0.0, 0
    for seed in range(count):
        difference, off = worst_difference(seed)
        skipped += off
        if difference > worst:
            worst = difference
            print(f"seed {seed}: {difference / DEFAULT_TOLERANCE:.3f} of the tolerance", flush=True)
        if difference > DEFAULT_TOLERANCE:
            sys.exit(f"seed {seed} differs by more than the tolerance")
    print(
        f"{count} scenes, {skipped / count:.1f} of 11 effects skipped on average, "
        f"worst difference {worst / DEFAULT_TOLERANCE:.3f} of the tolerance"
    )


if __name__ == "__main__":
    main()
