"""`matcap-lab bench`: what commands hand to their experiments and print of them."""

import pytest

from matcap_lab.bench import fields, floors, reflectance
from matcap_lab.experiment.runner import Configuration, Experiment


@pytest.fixture
def asked(monkeypatch):
    """Experiments of one number in place of the real ones; gives the arguments of their making."""
    calls = []

    def made(*arguments, **options):
        calls.append((arguments, options))
        return Experiment(
            "floors",
            {"leather": lambda: 4.3},
            {"exemplar": Configuration(lambda number, _seed: number)},
            (lambda number, _outcome: {"NSD": number, "seconds": 1.0},),
        )

    for module, name in (
        (fields, "fields"),
        (reflectance, "highlight"),
        (floors, "nsd"),
    ):
        monkeypatch.setattr(module, f"{name}_experiment", made)
    return calls


def test_the_table_is_printed_and_written(lab, asked, tmp_path):
    said = lab("bench", "floors", "leather", "--stops", "-0.67", "-o", tmp_path / "f")
    assert said.code == 0
    assert "| leather | exemplar | 1.00 | 4.30 |" in said.out
    assert said.err == "leather, exemplar: seconds 1.00, NSD 4.30\n"
    assert sorted(f.name for f in (tmp_path / "f").iterdir()) == ["floors.csv"]
    (((subjects, out, settings, _evaluation), _),) = asked
    assert [s.name for s in subjects] == ["leather"]
    assert (settings.ev, out) == (-0.67, tmp_path / "f")
    again = lab("bench", "floors", "leather", "--stops", "-0.67", "-o", tmp_path / "f")
    assert (again.out, again.err) == (said.out, "")


def test_fields_and_highlights_are_of_what_is_named(lab, asked, tmp_path):
    assert lab("bench", "fields", "leather", "-o", tmp_path).code == 0
    assert lab("bench", "highlight", "--simulated", 2, "-o", tmp_path).code == 0
    (((subjects,), _), ((photographs, count, seed, out), options)) = asked
    assert [one.name for one in subjects] == ["leather"]
    assert (photographs, count, seed, out) == ((), 2, 0, tmp_path)
    assert options == {"has_fov": True}
    assert lab("bench", "fields", "nothing").code == 2
