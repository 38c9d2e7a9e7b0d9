"""Repetition is told from chance, and copies are counted by their size."""

import numpy as np
import pytest

from matcap.cli.main import main
from matcap.lab.bench.repetition import SIZES, copies, correlation, measure


def noise(seed, size=512):
    return np.random.default_rng(seed).standard_normal((size, size)).astype(np.float32)


def test_a_repeat_is_found_and_chance_is_not():
    tiled = np.tile(noise(1, 256), (2, 2))
    assert correlation(tiled, tiled) == pytest.approx(1.0, abs=1e-3)
    assert correlation(noise(1), noise(1)) < 0.02
    assert correlation(noise(1), noise(2)) < 0.02
    # A copy of a quarter, 200 texels on.
    partly = noise(3)
    partly[:256, 200:456] = partly[:256, :256]
    assert 0.05 < correlation(partly, partly) < 0.5


def test_copies_are_counted_by_their_texels():
    y, x = np.mgrid[0:64, 0:64]
    places = np.stack([x, y], axis=-1).astype(np.int16)
    assert copies(places) == (0, 0, 0, 0, 1, 0, 0)  # 64 x 64 is not below 4096
    places[10:20, 30:50] += 200  # 200 texels
    found = copies(places)
    assert found[1] == pytest.approx(200 / 4096) and found[3] == pytest.approx(3896 / 4096)
    scattered = np.random.default_rng(1).integers(0, 1000, (64, 64, 2)).astype(np.int16)
    assert copies(scattered)[0] > 0.99
    assert len(found) == len(SIZES) + 1 and sum(found) == pytest.approx(1.0)


def test_a_small_field_is_measured(monkeypatch):
    monkeypatch.setattr("matcap.lab.bench.repetition._COPIED", 256)
    from matcap.example.example import Example
    from matcap.lab.bench.by_example import true_exemplar

    found = measure("leather", Example.of(true_exemplar("leather", 192, 160)), 512)
    assert found.own < found.other + 0.15 and 0.8 < found.diversity < 1.2
    assert sum(found.copies) == pytest.approx(1.0)


def test_a_material_without_an_exemplar_is_refused(tmp_path, capsys):
    assert main(["bench", "repetition", str(tmp_path / "none.matcap"), "--size", "512"]) == 3
    assert "no such file" in capsys.readouterr().err


def test_the_command_keeps_the_lattice_of_a_simulated_material(monkeypatch, capsys):
    monkeypatch.setattr("matcap.lab.bench.repetition._EXEMPLAR", (320, 288))
    assert main(["bench", "repetition", "tile", "--size", "512"]) == 0
    row = capsys.readouterr().out.splitlines()[-2].split("|")
    assert row[1].strip() == "tile"
    # What a lattice repeats by right is in both.
    assert 0.3 < float(row[2]) < float(row[3]) + 0.1
