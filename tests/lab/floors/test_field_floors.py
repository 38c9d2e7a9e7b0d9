"""What `matcap bench fields` measures beside floors."""

import numpy as np

from matcap.lab.floors.fields import FieldRow, fields_markdown, grating, joint_length, phase_off


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


def test_the_table_has_a_line_a_material_and_means_by_group():
    rows = [
        FieldRow("leather", 1.0, 1.0, 1.2, 1.1, None, None),
        FieldRow("rust", 0.1, 1.2, 1.4, 1.3, 0.9, 0.01),
        FieldRow("bond:3", 0.1, 0.9, 2.4, 1.0, None, None),
    ]
    text = fields_markdown(rows, "matcap bench fields leather")
    assert "| rust | 0.1 | 1.20 | 1.40 | 1.30 | 0.90 | 0.010 |" in text
    assert "| mean of examples | | 1.10 | 1.30 | 1.20 | | |" in text
    assert "| worst of examples | | 1.20 | 1.40 | 1.30 | | |" in text
    assert "| mean of kinds | | 0.90 | 2.40 | 1.00 | | |" in text
