"""Pictures against Mitsuba 3's, stored in references/; made again by make_references.py.

Limits: the root mean square and the largest difference, both relative to the reference's mean.
Flat scenes are compared at 1e-3 (rms); the largest may be a few times that where a light's rim
crosses a highlight. Failure writes the picture beside the report.
"""

import pytest
from reference_errors import embossed, errors, lit, reference, surrounded

from matcap.files.exr import write_exr


def compare(found, expected, rms, largest, folder):
    error, most = errors(found, expected)
    if error > rms or most > largest:
        write_exr(folder / "found.exr", found, half=False)
        pytest.fail(f"rms {error:.2e}, largest {most:.2e}; see {folder}/found.exr")


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
    compare(lit(name), reference(name), rms, largest, tmp_path)


def test_light_of_the_surroundings_on_flat_maps(tmp_path):
    # As the tolerance says, 144 directions or 2584.
    for finer, rms, largest in ((1.0, 1e-3, 4e-3), (16.0, 3e-4, 1e-3)):
        compare(surrounded(finer), reference("sky"), rms, largest, tmp_path)


def test_each_effect_of_relief_brings_the_picture_nearer_the_truth():
    stages = list(embossed())
    found = [rms for rms, _ in stages]
    assert found == sorted(found, reverse=True)
    assert found[-1] < 0.4 * found[0]
    # The bounce's light is right on average.
    assert stages[-1][1].mean() == pytest.approx(reference("embossed_bounce").mean(), rel=0.02)
