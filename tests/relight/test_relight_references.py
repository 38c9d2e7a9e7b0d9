"""Pictures against Mitsuba 3's, stored in references/; made again by make_references.py.

Limits: the root mean square and the largest difference, both relative to the reference's mean.
Flat scenes are compared at 1e-3 (rms); the largest may be a few times that where a light's rim
crosses a highlight. Failure writes the picture beside the report.
"""

from pathlib import Path

import numpy as np
import pytest
from reference_scenes import LIGHTS, embossed_maps, embossed_scene, flat_maps, flat_scene, sky_scene

from matcap.files.exr import read_exr, write_exr
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.render import relight

FOLDER = Path(__file__).parent / "references"
# Mitsuba's material here reflects once: the compensation for more is left out.
SINGLE = "all,-multiscatter"


def reference(name: str) -> np.ndarray:
    return read_exr(FOLDER / f"{name}.exr")


def compare(found, expected, rms, largest, folder):
    difference = np.abs(found - expected) / expected.mean()
    error = float(np.sqrt((difference**2).mean()))
    if error > rms or difference.max() > largest:
        write_exr(folder / "found.exr", found, half=False)
        pytest.fail(f"rms {error:.2e}, largest {difference.max():.2e}; see {folder}/found.exr")


@pytest.mark.parametrize(
    ("name", "rms", "largest"),
    [
        ("point", 1e-5, 1e-4),
        ("directional", 1e-5, 1e-4),
        ("sphere", 1e-3, 3e-3),
        ("rectangle", 1e-3, 3e-3),
    ],
)
def test_direct_light_on_flat_maps(name, rms, largest, tmp_path):
    found = relight(flat_maps(), flat_scene(LIGHTS[name]), effects=SINGLE)
    compare(found, reference(name), rms, largest, tmp_path)


def test_light_of_the_surroundings_on_flat_maps(tmp_path):
    scene = sky_scene(FOLDER / "surroundings.exr")
    # As the tolerance says, 144 directions or 2584.
    for finer, rms, largest in ((1.0, 1e-3, 4e-3), (16.0, 3e-4, 1e-3)):
        tolerance = DEFAULT_TOLERANCE / finer
        found = relight(flat_maps(), scene, effects=SINGLE, tolerance=tolerance)
        compare(found, reference("sky"), rms, largest, tmp_path)


def test_each_effect_of_relief_brings_the_picture_nearer_the_truth():
    """Path-traced mesh, direct light and one bounce; its pixels are averages, ours points."""
    truth = reference("embossed_bounce")
    errors = []
    effects = "none,+diffuse,+specular,+falloff"
    for effect in ("", ",+parallax", ",+shadows", ",+interreflection"):
        effects += effect
        found = relight(embossed_maps(), embossed_scene(), effects=effects)
        difference = (found - truth)[1:-1, 1:-1]
        errors.append(float(np.sqrt((difference**2).mean()) / truth.mean()))
    print("rms error, each effect added:", ", ".join(f"{error:.4f}" for error in errors))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.4 * errors[0]
    # The bounce's light is right on average.
    assert found.mean() == pytest.approx(truth.mean(), rel=0.02)
