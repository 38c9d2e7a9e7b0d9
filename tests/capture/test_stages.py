"""Stages, generators and presets of a capture."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from report_schema import check_report

from matcap.brdf.maps import MapSet
from matcap.capture import by_decoder
from matcap.capture.by_decoder import choose, photograph_target
from matcap.capture.pipeline import capture_photo
from matcap.capture.rectified import Method, Rectified, fit_photograph
from matcap.capture.report import read_report
from matcap.capture.run import capture_into
from matcap.capture.settings import (
    BOTH_STAGES,
    DRAWING_STAGES,
    EXEMPLAR_STAGES,
    PRESETS,
    UNLIMITED,
    CaptureClock,
    CaptureSettings,
    OutputSettings,
    RunStatus,
    check_photographs,
    resolve,
)
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.field.material import Material
from matcap.photo.load import load_photo
from matcap.space.prior.store import load_prior
from matcap.space.tuned import TunedDecoder
from matcap.statistics.compare import shading

# The capture is one chain of named stages, and the paper's decoder is no part of it.


PHOTO = Path(__file__).parents[2] / "examples/photos/tile.jpg"
pytestmark = pytest.mark.usefixtures("one_coarse_fit")
DETAIL = 160
SETTINGS = CaptureSettings(detail=DETAIL)


@pytest.fixture(scope="module")
def captured(one_coarse_fit, tmp_path_factory):
    """Result, folder and progress of a capture by a generator, fine-tuned in a step or two."""
    real = by_decoder.TuneSettings

    @cache
    def of(generator):
        folder, lines = tmp_path_factory.mktemp("captured") / "tile", []
        steps = 2 if generator == "decoder" else None
        settings = replace(SETTINGS, generator=generator, steps=steps)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(by_decoder, "TuneSettings", lambda *_, **own: real(**{"steps": 1} | own))
            result = capture_into(folder, [PHOTO], settings, OutputSettings((32, 32)), lines.append)
        return result, folder, lines

    return of


@pytest.mark.capture
@pytest.mark.parametrize(
    ("generator", "stages", "longest"),
    [("example", EXEMPLAR_STAGES, None), (None, BOTH_STAGES, None),
     ("decoder", DRAWING_STAGES, "fine-tuning")],
)  # fmt: skip
def test_every_stage_has_its_share_and_is_reported_in_order(captured, generator, stages, longest):
    assert sum(stages.values()) == pytest.approx(1.0)
    result, folder, lines = captured(generator)
    assert list(dict.fromkeys(now.stage for now in lines)) == list(stages)
    assert list(result.stage_seconds) == list(stages)
    fractions = [now.fraction for now in lines]
    assert fractions == sorted(fractions) and fractions[-1] == pytest.approx(1.0)
    within = [now for now in lines if now.stage == longest]
    assert longest is None or len(within) >= 4  # begun, every step, done
    check_report(folder / "report.json")
    report = json.loads((folder / "report.json").read_text())
    assert list(report["stage_seconds"]) == list(stages)[:-1]
    assert (report["tuning"] is None) == (generator == "example")
    draws = report["tuning"] is not None and report["tuning"]["drawing"]
    assert draws == (generator != "example")
    # With what ends a decoder's capture, matching, too.
    again = result.material.maps(*result.maps.size, generator=generator or "example")
    assert torch.equal(again.stacked(), result.maps.stacked())


@pytest.mark.capture
@pytest.mark.usefixtures("two_threads")
def test_a_capture_is_the_same_by_two_threads(captured, monkeypatch, tmp_path):
    """Highlight, relief and inpainting of a photograph with all of them."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    _, folder, _ = captured("example")
    settings = replace(SETTINGS, generator="example")
    capture_into(tmp_path / "tile", [PHOTO], settings, OutputSettings((32, 32)))
    assert torch.get_num_threads() == 2
    names = [path.name for path in folder.iterdir() if path.suffix != ".json"]
    assert len(names) == 7
    for name in names:
        assert (folder / name).read_bytes() == (tmp_path / "tile" / name).read_bytes(), name
    by_one, again = (read_report(each / "report.json") for each in (folder, tmp_path / "tile"))
    assert again["verdict"] == by_one["verdict"]


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
import os, sys, torch  # once for both
from matcap.cli.main import main
photo, out = sys.argv[1:]
capture = ["capture", photo, "-o", out, "--detail", "160", "--size", "64", "-q"]
work = [
    ["synth", f"{out}/tile/tile.matcap", "--size", "64x32", "-o", f"{out}/set", "-q"],
    ["relight", f"{out}/tile", "--light", "left", "-o", f"{out}/left.png", "-q"],
    ["export", f"{out}/tile", "--to", "gltf", "--size", "64", "-o", f"{out}/gltf", "-q"],
    ["view", f"{out}/tile", "--html", f"{out}/tile.html", "--tile", "64", "-q"],
]
if child := os.fork():
    assert os.waitpid(child, 0)[1] == 0
else:
    work = [[*capture, "--generator", "example"]]
for words in work:
    code = main(words)
    assert code == 0, (words, code)
    # PyTorch's compiler, which many of its functions import, takes 0.3 to 2 s.
    assert not {"sympy", "torch._dynamo"} & set(sys.modules), words
of_decoder = [name for name in sys.modules if name.startswith("matcap.space")]
assert not child or of_decoder == [], of_decoder
"""
    command = [sys.executable, "-c", program, str(PHOTO), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# The decoder beside an exemplar: both in one material, the choice, and what Ctrl-C keeps.


@pytest.mark.capture
def test_a_capture_has_both_generators_its_code_and_a_choice(captured, tmp_path):
    result, folder, _ = captured(None)
    material = Material.load(folder / "tile.matcap")
    assert set(material.generators) == {"example", "decoder"}
    assert material.part(TunedDecoder).drawing.example is material.generators["example"]
    report = read_report(folder / "report.json")
    assert report["generators"]["generator"] == material.made_by == result.choice.generator
    assert report["effort"]["steps"] > 0 and report["tuning"]["drawing"]
    prior = load_prior()
    assert report["latent"]["prior"] == material.latent.prior == prior.digest
    assert torch.equal(prior.near(material.latent).code, result.material.latent.code)
    sheet = tmp_path / "like.png"
    assert main(["sample", "--like", str(folder), "-n", "1", "-o", str(sheet), "-q"]) == 0
    other = replace(material.latent, prior="0" * 64)
    replace(material, latent=other).save(tmp_path / "other.matcap")
    assert main(["sample", "--like", str(tmp_path / "other.matcap"), "-o", str(sheet)]) != 0


@pytest.mark.capture
def test_without_fine_tuning_there_is_an_exemplar_and_a_code(captured):
    result, _, _ = captured("example")
    assert set(result.material.generators) == {"example"} and result.choice is None
    assert result.material.latent is not None and result.effort.steps == 0


@pytest.mark.capture
def test_an_interrupt_keeps_the_material_by_example(monkeypatch):
    def interrupted(*_args, **_named):
        raise KeyboardInterrupt

    monkeypatch.setattr(by_decoder, "tuned_decoder", interrupted)
    result = capture_photo(load_photo(PHOTO, long_side=DETAIL), SETTINGS)
    assert result.status is RunStatus.INTERRUPTED and set(result.material.generators) == {"example"}


def test_the_field_that_looks_like_the_photograph_is_chosen():
    photo = load_photo(PHOTO, long_side=DETAIL)
    coarse = fit_photograph(photo)
    rectified = Rectified.of(photo, coarse, DETAIL)
    target, plane = photograph_target(rectified, Method()), rectified.whole
    height, width = plane.linear.shape[1:]
    flat, uniform = torch.ones(1, height, width), torch.tensor(coarse.diffuse)[:, None, None]
    texture = plane.linear / shading(plane.linear[None])[0].clamp_min(1e-3)
    albedos = [(uniform * texture).clamp(0.01, 1.0), uniform.expand_as(texture)]
    rest = coarse.specular * flat, coarse.roughness * flat, 0.0 * flat, plane.texel_size
    one, other = (MapSet(albedo, *rest) for albedo in albedos)
    assert choose(one, other, target, plane).generator == "example"
    assert choose(other, one, target, plane).generator == "decoder"
    finer = other.stacked().repeat_interleave(2, 1).repeat_interleave(2, 2)
    flat_but_finer = MapSet.from_stacked(finer, other.texel_size / 2.0)
    assert choose(flat_but_finer, one, target, plane).generator == "example"


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
        ({}, 2048), ({"preset": "instant"}, 512), ({"preset": "draft"}, 1024),
        ({"preset": "instant", "generator": "decoder"}, 1024),
        ({"preset": "draft", "generator": "decoder"}, 1024),
        ({"time_limit": 8.0}, 512), ({"time_limit": 26.0}, 1024), ({"time_limit": 90.0}, 2048),
        ({"detail": 640}, 640), ({"preset": "instant", "detail": 4000}, 4000),
    ],
)  # fmt: skip
def test_the_piece_has_the_finest_texels_where_there_is_time_for_them(asked, wanted):
    settings = CaptureSettings(**asked)
    assert settings.most_detail == settings.detail_of(4032) == wanted
    # A photograph of fewer pixels is enlarged only where that was asked for.
    assert {settings.detail_of(pixels) for pixels in (800, 1600, 2000)} == {
        settings.detail or min(wanted, 1024)
    }


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


@pytest.mark.parametrize("name", ["fast", "high", "reference"])
def test_an_unknown_preset_is_a_usage_error_that_names_the_presets(name):
    with pytest.raises(UsageError, match=f"'{name}'.*instant, draft, standard"):
        resolve(CaptureSettings(preset=name))


def test_a_decoder_of_several_photographs_is_refused():
    with pytest.raises(UsageError, match="fine-tuned to one photograph"):
        check_photographs(CaptureSettings(generator="decoder"), 2)
