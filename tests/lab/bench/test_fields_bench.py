"""What `matcap bench fields` measures beside floors."""

import math

import numpy as np

from matcap.lab.bench import fields
from matcap.lab.bench.fields import fields_experiment, grating, joint_length, phase_off
from matcap.lab.experiment.runner import run
from matcap.lab.measures.evaluator import EvaluationSettings
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import subjects


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
