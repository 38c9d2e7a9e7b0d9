"""Stages and presets of a capture."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from report_schema import check_report

from matcap.capture.pipeline import capture_into
from matcap.capture.settings import (
    BOTH_STAGES,
    DRAWING_STAGES,
    EXEMPLAR_STAGES,
    PRESETS,
    UNLIMITED,
    CaptureClock,
    CaptureSettings,
    OutputSettings,
    check_photographs,
    resolve,
)
from matcap.errors import UsageError

# The capture is one chain of named stages, and the paper's decoder is no part of it.


PHOTO = Path(__file__).parents[2] / "examples/photos/tile.jpg"


@pytest.mark.capture
@pytest.mark.parametrize(
    ("generator", "stages", "longest"),
    [
        ("example", EXEMPLAR_STAGES, None),
        (None, BOTH_STAGES, None),
        ("decoder", DRAWING_STAGES, "fine-tuning"),
    ],
)
@pytest.mark.filterwarnings("ignore:`torch.jit.script:DeprecationWarning")
def test_every_stage_has_its_share_and_is_reported_in_order(tmp_path, generator, stages, longest):
    assert sum(stages.values()) == pytest.approx(1.0)
    lines = []
    settings = CaptureSettings(detail=160, generator=generator)
    if generator == "decoder":
        settings = replace(settings, steps=2)
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
    assert draws == (generator != "example")


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


def test_start_up_time_counts_towards_the_time_limit():
    stages = {"before": 0.2, "long": 0.6, "after": 0.2}
    whole, started = (CaptureClock(None, stages, 1000.0, spent) for spent in (0.0, 10.0))
    assert whole.left_for("long") - started.left_for("long") == pytest.approx(20.0, abs=1.0)


def test_a_stage_without_a_share_raises():
    with pytest.raises(KeyError), CaptureClock(None).stage("fine-tuning"):
        pass


@pytest.mark.capture
def test_a_material_by_example_loads_no_compiler_and_nothing_of_the_decoder(tmp_path):
    """Capture in a process of its own, which encodes; then synth, relight, export and view."""
    program = """
import sys
from matcap.cli.main import main
photo, out, first = sys.argv[1:]
capture = ["capture", photo, "-o", out, "--detail", "160", "--size", "64", "-q"]
work = [[*capture, "--generator", "example"]] if first else [
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
    for first in ("first", ""):
        command = [sys.executable, "-c", program, str(PHOTO), str(tmp_path), first]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert ast.literal_eval(done.stdout.strip().splitlines()[-1]) == []


# Presets: what each spends, and what settings make of it.


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_its_effort_unless_steps_are_given(preset):
    effort = resolve(CaptureSettings(preset=preset, generator="decoder"))
    assert effort is PRESETS[preset] and effort.preset == preset
    alone = CaptureSettings(preset=preset, generator="example")
    assert resolve(alone) == replace(effort, steps=0)
    # Beside the exemplar, standard alone fine-tunes a decoder, unless time is limited.
    both = resolve(CaptureSettings(preset=preset))
    assert both == replace(effort, steps=effort.decoder_steps)
    assert (both.steps > 0) == (preset == "standard")
    assert resolve(CaptureSettings(preset=preset, time_limit=90.0)).steps == 0
    fewer = resolve(CaptureSettings(preset=preset, steps=7, generator="decoder"))
    assert fewer == replace(effort, steps=7)


def test_a_time_limit_without_steps_takes_unlimited_steps():
    asked = {"preset": "draft", "generator": "decoder", "time_limit": 20.0}
    assert resolve(CaptureSettings(**asked)).steps == UNLIMITED.steps > PRESETS["standard"].steps
    assert resolve(CaptureSettings(**asked, steps=7)).steps == 7


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ({}, 2048),
        ({"preset": "instant"}, 512),
        ({"preset": "instant", "generator": "decoder"}, 1024),
        ({"preset": "draft"}, 1024),
        ({"preset": "draft", "generator": "decoder"}, 1024),
        ({"time_limit": 8.0}, 512),
        ({"time_limit": 26.0}, 1024),
        ({"time_limit": 90.0}, 2048),
        ({"detail": 640}, 640),
        ({"preset": "instant", "detail": 4000}, 4000),
    ],
)
def test_the_piece_has_the_finest_texels_where_there_is_time_for_them(asked, wanted):
    settings = CaptureSettings(**asked)
    assert settings.most_detail == settings.detail_of(4032) == wanted
    # A photograph of fewer pixels is enlarged only where that was asked for.
    assert settings.detail_of(1600) == (settings.detail or min(wanted, 1024))


@pytest.mark.parametrize(
    ("option", "asked"),
    [
        ("--steps", {"steps": 7}),
        ("--prior", {"prior": "none"}),
        ("--prior", {"prior": "/nonexistent"}),
        ("--no-drawing", {"drawing": False}),
    ],
)
def test_settings_that_only_a_decoder_uses_are_refused_without_it(option, asked):
    with pytest.raises(UsageError, match=f"{option}: only .*--generator decoder"):
        resolve(CaptureSettings.of(asked))
    resolve(CaptureSettings.of({**asked, "generator": "decoder"}))


def test_presets_cost_more_and_more():
    for costs in (
        [effort.steps * effort.places for effort in PRESETS.values()],
        [effort.detail for effort in PRESETS.values()],
    ):
        assert costs == sorted(set(costs))


def test_a_photograph_of_fewer_pixels_has_the_most_that_it_fills():
    standard = CaptureSettings()
    assert [standard.detail_of(pixels) for pixels in (800, 2000, 4032)] == [1024, 1024, 2048]


@pytest.mark.parametrize("name", ["fast", "high", "reference"])
def test_an_unknown_preset_is_a_usage_error_that_names_the_presets(name):
    with pytest.raises(UsageError, match=f"'{name}'.*instant, draft, standard"):
        resolve(CaptureSettings(preset=name))


def test_a_decoder_of_several_photographs_is_refused():
    with pytest.raises(UsageError, match="fine-tuned to one photograph"):
        check_photographs(CaptureSettings(generator="decoder"), 2)
