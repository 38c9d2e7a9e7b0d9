"""The profile of a capture has every stage, and its stages make up the whole."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from matcap.capture.progress import EXEMPLAR_STAGES
from matcap_lab.bench import profile
from matcap_lab.cli.main import main
from matcap_lab.experiment.results import read

EXAMPLES = Path(__file__).parents[3] / "examples/photos"
PROFILE = ["bench", "profile", "--preset", "instant"]


def test_stages_make_up_the_whole(tmp_path):
    small = cv2.resize(cv2.imread(str(EXAMPLES / "tile.jpg")), (320, 240))
    cv2.imwrite(str(tmp_path / "tile.jpg"), small)
    assert main([*PROFILE, str(tmp_path / "tile.jpg"), "-o", str(tmp_path)]) == 0
    rows = {row.configuration: row for row in read(tmp_path / "profile.csv")}
    assert list(rows) == [f"instant, {stage}" for stage in ("start", *EXEMPLAR_STAGES, "whole")]
    whole = rows.pop("instant, whole")
    for column in ("seconds", "clock"):
        parts = sum(row.number(column) for row in rows.values())
        assert parts == pytest.approx(whole.number(column), rel=0.1)
    peaks = [row.number("megabytes") for row in rows.values()]
    assert max(peaks) == whole.number("megabytes") > 200.0
    assert rows["instant, network"].number("seconds") > 0.0


OWN_PEAKS = """
from matcap.capture.progress import CaptureProgress
from matcap_lab.bench.profile import StageCosts
costs = StageCosts({}, {}, {})
for stage, megabytes in (("large", 200), ("small", 1)):
    costs.progress(CaptureProgress(stage, 0.0, 0.0, None))
    held = bytearray(megabytes << 20)
    held[:: 1 << 12] = b"1" * len(held[:: 1 << 12])
    costs.progress(CaptureProgress(stage, 1.0, 0.0, None))
    del held
print(costs.megabytes["large"] - costs.megabytes["small"])
"""


@pytest.mark.skipif(
    not os.access("/proc/self/clear_refs", os.W_OK), reason="the system keeps peaks"
)
def test_peak_memory_is_each_stages_own():
    """In a process of its own: allocators that keep freed memory would hide it."""
    done = subprocess.run(
        [sys.executable, "-c", OWN_PEAKS], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) > 100.0


def test_a_photograph_that_cannot_be_captured_is_named_after_one_try(tmp_path, capsys, monkeypatch):
    tried, once = [], profile.profiled
    monkeypatch.setattr(profile, "profiled", lambda *asked: tried.append(asked) or once(*asked))
    assert main([*PROFILE, str(tmp_path / "none.jpg"), "-o", str(tmp_path)]) == 3
    assert "none.jpg" in capsys.readouterr().err
    assert tried == [(tmp_path / "none.jpg", "instant")]


def test_an_unknown_preset_is_refused(tmp_path, capsys):
    asked = ["bench", "profile", "none.jpg", "--preset", "utmost", "-o", str(tmp_path)]
    assert main(asked) == 2
    assert "choose from instant" in capsys.readouterr().err
