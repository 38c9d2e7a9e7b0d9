"""The capture is one chain of named stages, and the paper's decoder is no part of it."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from report_schema import check_report

from matcap.capture.pipeline import capture_into
from matcap.capture.progress import DECODER_STAGES, DRAWING_STAGES, EXEMPLAR_STAGES, CaptureClock
from matcap.capture.settings import CaptureSettings, OutputSettings

PHOTO = Path(__file__).parents[2] / "examples/photos/tile.jpg"


@pytest.mark.parametrize(
    ("generator", "stages", "longest"),
    [
        ("example", EXEMPLAR_STAGES, None),
        ("decoder", DRAWING_STAGES, "fine-tuning"),
        ("decoder", DECODER_STAGES, "fine-tuning"),
    ],
)
@pytest.mark.filterwarnings("ignore:`torch.jit.script:DeprecationWarning")
def test_every_stage_has_its_share_and_is_reported_in_order(tmp_path, generator, stages, longest):
    assert sum(stages.values()) == pytest.approx(1.0)
    lines = []
    settings = CaptureSettings(detail=160)
    if generator == "decoder":
        drawing = stages is DRAWING_STAGES
        settings = replace(settings, steps=2, generator=generator, drawing=drawing)
    result = capture_into(
        tmp_path / "tile", [PHOTO], settings, OutputSettings((32, 32)), lines.append
    )
    assert list(dict.fromkeys(now.stage for now in lines)) == list(stages)
    assert list(result.stage_seconds) == list(stages)
    fractions = [now.fraction for now in lines]
    assert fractions == sorted(fractions) and fractions[-1] == pytest.approx(1.0)
    within = [now for now in lines if now.stage == longest]
    assert longest is None or len(within) >= 4  # begun, every step, done
    check_report(tmp_path / "tile" / "report.json")
    report = json.loads((tmp_path / "tile" / "report.json").read_text())
    assert list(report["stage_seconds"]) == list(stages)[:-1]
    assert (report["tuning"] is None) == (generator == "example")
    draws = report["tuning"] is not None and report["tuning"]["drawing"]
    assert draws == (stages is DRAWING_STAGES)


def test_a_time_limit_leaves_room_for_what_comes_after():
    stages = {"before": 0.2, "long": 0.6, "after": 0.2}
    clock = CaptureClock(None, stages, limit=1000.0)
    with clock.stage("before"):
        while clock.elapsed < 0.02:
            pass
    left = clock.left_for("long")
    assert 1000.0 - 4.0 * clock.elapsed < left < 1000.0 - 1.5 * 0.02
    assert CaptureClock(None, stages).left_for("long") == float("inf")
    assert CaptureClock(None, stages, limit=0.0).left_for("long") == 0.0


def test_what_starting_took_is_taken_off_a_time_limit():
    stages = {"before": 0.2, "long": 0.6, "after": 0.2}
    whole, started = (CaptureClock(None, stages, 1000.0, spent) for spent in (0.0, 10.0))
    assert whole.left_for("long") - started.left_for("long") == pytest.approx(20.0, abs=1.0)


def test_a_stage_without_a_share_is_a_bug():
    with pytest.raises(KeyError), CaptureClock(None).stage("fine-tuning"):
        pass


def test_a_default_material_loads_no_compiler_and_of_the_papers_system_one_branch(
    tmp_path,
):
    """Capture, synth, relight, export and view, in a process of its own."""
    program = """
import sys
from matcap.cli.main import main
photo, out = sys.argv[1:]
work = [
    ["capture", photo, "-o", out, "--detail", "160", "--size", "64", "-q"],
    ["synth", f"{out}/tile/tile.matcap", "--size", "64x32", "-o", f"{out}/set", "-q"],
    ["relight", f"{out}/tile", "--light", "left", "-o", f"{out}/left.png", "-q"],
    ["export", f"{out}/tile", "--to", "gltf", "--size", "64", "-o", f"{out}/gltf", "-q"],
    ["view", f"{out}/tile", "--html", f"{out}/tile.html", "-q"],
]
for words in work:
    code = main(words)
    assert code == 0, (words, code)
    # PyTorch's compiler, which many of its functions import, takes 0.3 to 2 s.
    assert not {"sympy", "torch._dynamo"} & set(sys.modules), words
print(sorted(name for name in sys.modules if name.startswith("matcap.space")))
"""
    command = [sys.executable, "-c", program, str(PHOTO), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = set(ast.literal_eval(done.stdout.strip().splitlines()[-1]))
    branch = {"alignment", "convergence", "layers", "picture"}
    assert loaded == {"matcap.space"} | {f"matcap.space.{name}" for name in branch}
