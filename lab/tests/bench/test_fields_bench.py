"""What `matcap-lab bench fields` and `repetition` measure."""

import math

import numpy as np
import pytest

from matcap_lab.bench import fields
from matcap_lab.bench.fields import (
    SIZES,
    copies,
    correlation,
    fields_experiment,
    grating,
    joint_length,
    phase_off,
    repetition_experiment,
    seam_contrast,
)
from matcap_lab.cli.main import main
from matcap_lab.experiment.results import read
from matcap_lab.experiment.runner import run
from matcap_lab.measures.evaluator import EvaluationSettings
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import subjects


def bricks(width, height):
    y, x = np.mgrid[:300, :400]
    row = y // height
    shifted = (x + row % 2 * (width // 2)) % width
    return np.where((y % height < 3) | (shifted < 3), 0.0, 1.0).astype(np.float32)


def test_joints_are_as_long_as_bricks_leave_them():
    short, long = joint_length(bricks(30, 18)), joint_length(bricks(60, 36))
    assert 1.6 < long / short < 2.6
    assert joint_length(np.zeros((64, 64), np.float32)) is None


def test_a_lattice_far_away_is_in_phase():
    assert phase_off(grating(17.3, 21.0, (320, 256))) < 0.03


def test_true_maps_are_near_themselves_and_only_fields_have_joints(tmp_path, monkeypatch):
    monkeypatch.setattr(fields, "_SIZE", (256, 192))
    evaluation = EvaluationSettings(192, 128, PhoneCamera(blur=0.01), truths=2, finer=2)
    experiment = fields_experiment(subjects(["rust"]), evaluation)
    exemplar, field, repeated = run(experiment, tmp_path / "fields.csv")
    assert exemplar.number("NSD") < 3.0 and repeated.number("NSD") < 3.0
    assert field.number("variety") > 0.0
    assert 0.3 < field.number("seam albedo") < 2.0 and 0.3 < field.number("seam slope 99 %") < 2.0
    assert math.isnan(exemplar.number("seam albedo"))
    assert math.isnan(exemplar.number("variety")) and math.isnan(exemplar.number("joints"))


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


def test_a_small_field_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr("matcap_lab.bench.fields._COPIED", 256)
    monkeypatch.setattr("matcap_lab.bench.fields._EXEMPLAR", (192, 160))
    (row,) = run(repetition_experiment(["leather"], 512), tmp_path / "repetition.csv")
    assert row.number("with itself") < row.number("of two seeds") + 0.15
    assert 0.8 < row.number("diversity") < 1.2
    shares = [value for name, value in row.values.items() if name.startswith(("below", "larger"))]
    assert sum(shares) == pytest.approx(1.0, abs=1e-4)


def test_a_material_without_an_exemplar_is_refused(tmp_path, capsys):
    asked = [str(tmp_path / "none.matcap"), "--size", "512", "-o", str(tmp_path)]
    assert main(["bench", "repetition", *asked]) == 3
    assert "no such file" in capsys.readouterr().err


def test_the_command_keeps_the_lattice_of_a_simulated_material(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("matcap_lab.bench.fields._EXEMPLAR", (320, 288))
    assert main(["bench", "repetition", "tile", "--size", "512", "-o", str(tmp_path)]) == 0
    assert "| tile | 512 x 512 texels |" in capsys.readouterr().out
    (row,) = read(tmp_path / "repetition.csv")
    # What a lattice repeats by right is in both.
    assert 0.3 < row.number("with itself") < row.number("of two seeds") + 0.1


def waves(height=400, width=600):
    """(6, H, W) maps of slow noise, about sixteen texels."""
    noise = np.random.default_rng(4).standard_normal((6, height, width))
    turns = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((30.0 * turns) ** 2))).real
    smooth /= smooth.std(axis=(1, 2), keepdims=True)
    maps = 0.3 * np.exp(0.2 * smooth)
    maps[5] = 0.01 * smooth[5]
    return maps.astype(np.float32)


def split(shift):
    """Places of a field whose right half lies elsewhere by a shift (x, y) of texels."""
    places = np.stack(np.meshgrid(np.arange(200), np.arange(300)), axis=-1)
    places[:, 100:] += shift
    return places


def measured_seams(maps, places, shown=None):
    shown = maps[:, places[..., 1], places[..., 0]] if shown is None else shown
    return seam_contrast(shown, places, maps, 0.002)


def test_what_was_not_rearranged_has_no_seams():
    assert np.isnan(list(measured_seams(waves(), split((0, 0))).values())).all()


def test_a_cut_shows_in_albedo_and_slope():
    found = measured_seams(waves(), split((317, 60)))
    assert found["seam albedo"] > 5.0 and found["seam slope"] > 5.0
    assert found["seam albedo 99 %"] > 3.0


def test_a_seam_that_what_it_shows_hides_measures_one():
    """Of a piece that repeats: another place, and the same texels."""
    maps = np.tile(waves(400, 300), (1, 1, 2))
    found = measured_seams(maps, split((300, 0)))
    for name in ("seam albedo", "seam slope"):
        assert 0.8 < found[name] < 1.25 and 0.7 < found[f"{name} 99 %"] < 1.3


def test_colour_alone_shows_in_albedo_alone():
    maps = np.tile(waves(400, 300), (1, 1, 2))
    places = split((300, 0))
    shown = maps[:, places[..., 1], places[..., 0]].copy()
    shown[0, :, 100:] *= 1.5
    found = measured_seams(maps, places, shown)
    assert found["seam albedo"] > 5.0 and 0.8 < found["seam slope"] < 1.25
