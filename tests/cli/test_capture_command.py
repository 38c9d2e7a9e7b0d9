"""`matcap capture` and its report."""

import errno
import filecmp
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from materials import a_material
from PIL import Image
from reference.formats import report_keys
from report_schema import check_report

from matcap.brdf.folder import mapset_files, read_mapset
from matcap.capture import preview, report
from matcap.capture import report as outputs
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.multiview.set_report import SetReport
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.register import LeftOut, RegisteredView
from matcap.capture.report import report as report_report
from matcap.capture.report import warnings, write_report
from matcap.capture.result import CaptureResult, Tuning
from matcap.capture.settings import (
    DECODER_STAGES,
    DRAWING_STAGES,
    EXEMPLAR_STAGES,
    MULTIVIEW_STAGES,
    SHOWN_STAGES,
    CaptureClock,
    CaptureSettings,
    slowness,
    within_time,
)
from matcap.cli.display import ShareDisplay
from matcap.errors import UsageError
from matcap.files.exr import read_exr
from matcap.flash.geometry import FlashSetup
from matcap.photo.inspect import inspect_photo

# `matcap capture`: its files, its messages, its exit codes; the capture itself is a fake.


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def test_all_outputs_stand_in_a_folder_of_the_photographs_name(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", "40x30", "--seed", 5)
    assert said.code == 0 and said.out == "" and str(out / "leather") in said.err
    exrs = {name for name in mapset_files("leather") if not name.endswith(".png")}
    names = {f.name for f in (out / "leather").iterdir()}
    assert names == exrs | {"leather.matcap", "preview.png", "report.json"}
    maps, document = read_mapset(out / "leather")
    assert maps.size == (40, 30) and document["seed"] == 5
    assert document["provenance"] == {"made": "up"}


def test_options_reach_the_pipeline(matcap, pipeline, photo, out):
    matcap(
        "capture", photo, "-o", out, "--preset", "draft", "--steps", 7, "--time", "2m", "--fov", 60,
        "--detail", 512, "--seed", 3, "--prior", "none", "--size", 16,
        "--generator", "decoder",
    )  # fmt: skip
    (call,) = pipeline.calls
    assert (call.path, call.long_side, call.fov) == (photo, 512, 60.0)
    asked = call.settings
    assert (asked.preset, asked.steps, asked.time_limit) == ("draft", 7, 120.0)
    assert (asked.detail, asked.fov, asked.seed, asked.prior) == (512, 60.0, 3, "none")


def test_known_properties_reach_the_pipeline_and_the_report(matcap, pipeline, photo, out):
    said = matcap(
        "capture", photo, "-o", out, "--dielectric", "--albedo", "0.18", "--roughness", "0.4"
    )  # fmt: skip
    assert said.code == 0
    settings = pipeline.calls[-1].settings
    assert (settings.metal, settings.albedo, settings.roughness) == (False, 0.18, 0.4)
    report = json.loads((out / "leather" / "report.json").read_text())
    assert report["settings"]["metal"] is False and report["settings"]["albedo"] == 0.18
    assert "metal" not in CaptureSettings().named()


def test_known_properties_are_of_one_photograph_and_within_limits(matcap, pipeline, photo, out):
    other = photo.with_name("other.dng")
    other.write_text("a photograph")
    said = matcap("capture", photo, other, "--together", "-o", out, "--albedo", "0.18")
    assert said.code == 2 and "--albedo: this is of one photograph" in said.err
    assert matcap("capture", photo, "-o", out, "--albedo", "3").code == 2
    both = matcap("capture", photo, "-o", out, "--metal", "--dielectric")
    assert both.code == 2 and "--metal --dielectric: one excludes the other" in both.err
    assert not pipeline.calls


def test_a_photograph_given_again_is_captured_once(matcap, pipeline, photo, out):
    again = photo.parent / "." / ".." / photo.parent.name / photo.name
    said = matcap("capture", photo, again, "-o", out, "--size", "32")
    assert said.code == 0 and "given more than once, captured once" in said.err
    assert [path.name for path in out.iterdir()] == ["leather"] and len(pipeline.calls) == 1


@pytest.mark.parametrize("form", ["png", "jpg"])
def test_maps_for_engines_stand_in_a_folder(matcap, pipeline, photo, out, form):
    assert matcap("capture", photo, "-o", out, "--size", "32", "--maps", form).code == 0
    files = {path.name for path in (out / "leather" / "maps").iterdir()}
    kinds = ("basecolor", "metallic", "roughness", "ambientocclusion")
    assert {f"leather_{kind}.{form}" for kind in kinds} <= files
    assert "leather_height.png" in files and any("normal_gl" in name for name in files)


def test_a_too_short_time_limit_is_refused_at_once(matcap, pipeline, out):
    said = matcap("capture", "missing.jpg", "-o", out, "--time", "0.05")
    assert said.code == 2 and not pipeline.calls
    assert "the shortest capture takes about" in said.err and "missing.jpg" not in said.err


@pytest.mark.parametrize(
    ("seconds", "photographs", "slower", "detail"),
    [
        (12, 1, 1.0, 512),
        (26, 1, 1.0, 1024),
        (75, 1, 1.0, 2048),
        (75, 1, 2.0, 1024),
        (51, 5, 1.0, 512),
    ],
)
def test_the_detail_is_what_fits_into_the_time(seconds, photographs, slower, detail):
    limited = CaptureSettings(time_limit=float(seconds))
    assert within_time(limited, photographs, slower).detail == detail
    assert within_time(replace(limited, detail=700), photographs, slower).detail == 700


def test_a_slow_machine_needs_more_time():
    with pytest.raises(UsageError, match="takes about 36 s"):
        within_time(CaptureSettings(time_limit=29.0), 1, 3.0)
    assert within_time(CaptureSettings(), 1, 1e9) == CaptureSettings() and slowness() > 0.0


def test_pngs_and_directx_normals(matcap, pipeline, photo, out):
    assert matcap("capture", photo, "-o", out, "--size", 16, "--png", "--normal", "dx").code == 0
    assert set(mapset_files("leather")) <= {f.name for f in (out / "leather").iterdir()}
    assert read_mapset(out / "leather")[1]["normal"] == "dx"


def test_the_preview_shows_eight_panels_and_their_crops(matcap, pipeline, photo, out):
    matcap("capture", photo, "-o", out, "--size", 16)
    with Image.open(out / "leather" / "preview.png") as sheet:
        assert sheet.mode == "RGB" and sheet.width > 8 * 256
        # The photograph's panel: a quarter of full light is sRGB 137.
        assert sheet.getpixel((270, 200)) == (137, 137, 137)


def test_the_report_states_settings_and_results(matcap, pipeline, photo, out):
    options = ("--steps", 9, "--generator", "decoder")
    matcap("capture", photo, "-o", out, "--size", 16, *options)
    report = json.loads((out / "leather" / "report.json").read_text())
    assert report["settings"]["steps"] == 9
    tuning = report["tuning"]
    assert tuning["error"] == 0.5 and tuning["relative_error"] == 2.0
    assert report["error"] == {"exemplar": None, "field": None}  # too small a picture
    assert "one plain colour" in report["verdict"]["sentence"]
    assert tuning["error_over_time"][0] == {"seconds": 0.5, "step": 1, "error": 0.9}
    assert report["stage_seconds"] == {"coarse fit": 0.5, "fine-tuning": 0.5}
    assert report["camera"]["tilt_degrees"] == [0.0, 0.0]
    assert report["photograph"]["clipped_share"] == 0.0
    assert {"matcap", "torch", "python"} <= set(report["versions"])


def test_the_verdict_is_printed_and_strict_sets_the_exit_code(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", 16)
    assert said.code == 0
    assert "failed: the picture is one plain colour, without" in said.err
    assert "error" not in said.err
    again = ("--size", 16, "--strict", "--overwrite")
    assert matcap("capture", photo, "-o", out, *again).code == 3


def test_json_is_all_of_stdout(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", 16, "--json", "-q")
    (result,) = json.loads(said.out)["photographs"]
    assert said.err == "" and result["status"] == "done"
    assert set(result["error"]) == {"exemplar", "field"}
    assert result["verdict"]["rating"] == "failed"  # even grey shows no flash
    assert result["material"] == str(out / "leather" / "leather.matcap")


def test_progress_is_plain_lines_where_there_is_no_terminal(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", 16)
    assert "preparing the texture" in said.err
    assert "\x1b" not in said.err and "index" not in said.err
    assert len(said.err.splitlines()) == 4  # two stages, what was made, the verdict


def test_every_stage_is_shown_in_words():
    for stages in (EXEMPLAR_STAGES, MULTIVIEW_STAGES, DECODER_STAGES, DRAWING_STAGES):
        assert set(stages) <= set(SHOWN_STAGES)


def test_long_work_is_shown_by_lines_where_there_is_no_terminal(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr("matcap.cli.display.time.monotonic", lambda: now[0])
    with ShareDisplay.open(quiet=False) as shown:
        shown.progress(0.1, "blending")
        now[0] = 11.0
        shown.progress(0.4, "blending")
    assert capsys.readouterr().err.split() == ["40.0", "%", "blending"]


def test_notes_of_reading_are_printed(matcap, pipeline, photo, out):
    pipeline.notes = ("The file states no white balance: daylight (D65) assumed.",)
    said = matcap("capture", photo, "-o", out, "--size", 16, "--json")
    assert said.err.splitlines()[-1].strip() == pipeline.notes[0]
    assert json.loads(said.out)["photographs"][0]["notes"] == list(pipeline.notes)
    other = photo.with_name("b.dng")
    other.write_text("another photograph")
    said = matcap("capture", photo, other, "--together", "-o", out, "--size", 16, "--overwrite")
    assert f"b.dng: {pipeline.notes[0]}" in said.err


def test_photographs_that_a_set_leaves_out_are_named(matcap, pipeline, photo, out, monkeypatch):
    first = RegisteredView(SimpleNamespace(name="leather.dng"), PosedCamera.of(FlashSetup()))
    blurred = (LeftOut("b.dng", "it is blurred"),)
    measured, offset, mosaic = (0.9, 0.3, 0.4, 0.8), (0.0, 0.2, 0.0), Mosaic.own((64, 48))
    several = SetReport((first,), (0.02,), (), blurred, measured, offset, mosaic)
    monkeypatch.setattr(CaptureResult, "several", several)
    other = photo.with_name("b.dng")
    other.write_text("another photograph")
    said = matcap("capture", photo, other, "--together", "-o", out, "--size", 16)
    assert said.code == 0 and "b.dng was left out: it is blurred." in said.err


def test_photographs_of_the_same_stem_do_not_overwrite_each_other(matcap, pipeline, photo, out):
    other = photo.with_suffix(".JPG")
    other.write_text("another photograph")
    assert matcap("capture", photo, other, "-o", out, "--size", 16).code == 0
    assert sorted(f.name for f in out.iterdir()) == ["leather", "leather-2"]
    assert (out / "leather-2" / "leather-2.matcap").is_file()


def test_one_bad_photograph_exits_with_3_and_leaves_nothing(matcap, tmp_path, out):
    said = matcap("capture", tmp_path / "none.dng", "-o", out)
    assert (said.code, said.out) == (3, "")
    assert said.err == f"matcap: {tmp_path / 'none.dng'}: there is no such file; check the name.\n"
    assert list(tmp_path.iterdir()) == []


def test_other_photographs_go_on_and_the_exit_code_is_4(matcap, pipeline, photo, tmp_path, out):
    empty = tmp_path / "empty.dng"
    empty.touch()
    said = matcap("capture", empty, photo, "-o", out, "--size", 16, "--json")
    assert said.code == 4 and "the file is empty; copy it again." in said.err
    results = json.loads(said.out)["photographs"]
    assert [result["status"] for result in results] == ["failed", "done"]
    assert [f.name for f in out.iterdir()] == ["leather"]


def test_an_interruption_saves_the_best_so_far_and_exits_with_130(
    matcap, pipeline, photo, tmp_path, out
):
    pipeline.interrupt = True
    second = shutil.copy(photo, tmp_path / "second.dng")
    said = matcap("capture", photo, second, "-o", out, "--size", 16, "--json")
    assert said.code == 130
    (result,) = json.loads(said.out)["photographs"]  # the second one is not begun
    assert result["status"] == "interrupted"
    report = json.loads((out / "leather" / "report.json").read_text())
    assert report["interrupted"] is True and "best so far" in report["warnings"][0]
    assert read_mapset(out / "leather")[0].size == (16, 16)


def test_an_early_interruption_exits_with_130_and_leaves_nothing(
    matcap, pipeline, photo, tmp_path, out
):
    pipeline.failure = KeyboardInterrupt()
    second = shutil.copy(photo, tmp_path / "second.dng")
    said = matcap("capture", photo, second, "-o", out, "--json")
    assert said.code == 130
    assert said.err == f"matcap: {photo}: interrupted before there was anything to save.\n"
    assert [r["status"] for r in json.loads(said.out)["photographs"]] == ["interrupted"]
    assert {*tmp_path.iterdir()} == {photo, second}


def test_a_bug_exits_with_1_and_one_sentence(matcap, pipeline, photo, tmp_path, out, monkeypatch):
    monkeypatch.delenv("MATCAP_DEBUG", raising=False)
    pipeline.failure = RuntimeError("shapes do not match")
    said = matcap("capture", photo, "-o", out, "-q")
    assert said.code == 1 and said.err.count("\n") == 1
    assert "internal error (RuntimeError: shapes do not match)" in said.err
    assert list(tmp_path.iterdir()) == [photo]


def test_a_setting_refused_by_the_pipeline_exits_with_2(matcap, pipeline, photo, out):
    pipeline.failure = UsageError("no preset 'fast'", where="--preset", remedy="use draft")
    said = matcap("capture", photo, "-o", out, "-q")
    assert said.code == 2 and said.err == "matcap: --preset: no preset 'fast'; use draft.\n"


def test_the_folder_is_checked_before_any_work(matcap, pipeline, photo, tmp_path):
    said = matcap("capture", photo, "-o", photo / "out")
    assert said.code == 3
    assert "a file stands where a folder is needed; choose another folder with -o." in said.err
    said = matcap("capture", photo, "-o", tmp_path / "out", "--size", "100000000x10000")
    assert said.code == 3 and "are needed but the disk has" in said.err and pipeline.calls == []
    assert list(tmp_path.iterdir()) == [photo]


@pytest.mark.parametrize("fails_at", ["write_mapset", "write_preview", "write_report"])
def test_a_disk_that_fills_while_saving_leaves_nothing(
    matcap, pipeline, photo, tmp_path, out, monkeypatch, fails_at
):
    home = {"write_mapset": outputs, "write_preview": preview, "write_report": report}[fails_at]

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(home, fails_at, full)
    said = matcap("capture", photo, "-o", out, "--size", 16, "-q")
    assert said.code == 3 and said.err.count("\n") == 1
    assert "the disk is full; free some space or choose another folder with -o." in said.err
    assert list(tmp_path.iterdir()) == [photo]


def test_the_first_map_set_tiles_or_its_size_is_noted(matcap, pipeline, photo, out):
    assert "do not repeat" not in matcap("capture", photo, "-o", out, "--size", 32).err
    assert read_mapset(out / "leather" / "leather.json")[1]["periodic"] is True
    said = matcap("capture", photo, "-o", out, "--size", 40, "--overwrite")
    assert "Maps of 40x40 do not repeat" in said.err and "multiples of 16" in said.err
    assert read_mapset(out / "leather" / "leather.json")[1]["periodic"] is False
    assert matcap("capture", photo, "-o", out, "--size", 40, "--tile", "--overwrite").code == 2


def test_an_earlier_capture_is_replaced_with_overwrite_alone(matcap, pipeline, photo, out):
    assert matcap("capture", photo, "-o", out, "--size", 16).code == 0
    before = (out / "leather" / "report.json").read_bytes()
    for again in ((), ("--seed", 1)):
        said = matcap("capture", photo, "-o", out, "--size", 16, *again)
        assert said.code == 3 and "this exists already" in said.err and "--overwrite" in said.err
        assert (out / "leather" / "report.json").read_bytes() == before
        assert matcap("capture", photo, "-o", out, "--size", 16, *again, "--overwrite").code == 0
        before = (out / "leather" / "report.json").read_bytes()


def test_photographs_of_one_sample_make_one_material(matcap, pipeline, photo, out):
    other = photo.with_name("again.dng")
    other.write_text("the same sample")
    assert matcap("capture", photo, other, "--together", "-o", out, "--size", 16).code == 0
    assert [call.path for call in pipeline.calls] == [photo, other]
    assert pipeline.calls[-1].others == ["again.dng"]
    assert [folder.name for folder in out.iterdir()] == ["leather"]


def test_a_width_in_centimetres_reaches_the_capture(matcap, pipeline, photo, out):
    matcap("capture", photo, "-o", out, "--size", 16, "--width-cm", 20)
    (call,) = pipeline.calls
    assert call.settings.width_cm == 20.0 and call.settings.millimetres_per_unit == 100.0
    notes = json.loads((out / "leather" / "report.json").read_text())["notes"]
    assert not any("how large" in note for note in notes)


# What the report warns of, and that it is always JSON.


STAGES = {**EXEMPLAR_STAGES, **DECODER_STAGES}


@pytest.fixture
def captured(pipeline, photo):
    """A result without anything to warn of."""
    return _captured(pipeline, photo, CaptureSettings(detail=96, generator="example"))


def _captured(pipeline, photo, settings):
    shown = pipeline.load_photo(photo)
    return pipeline.capture_photo(shown, settings, clock=CaptureClock(None, STAGES))


def test_a_good_capture_has_no_warnings(captured):
    assert list(warnings(captured)) == []


def test_each_warning_says_what_to_do(captured):
    def warned(tilt=(0.0, 0.0), **photographed):
        photo = replace(captured.photo, **photographed)
        seen = replace(captured.measurements, photograph=inspect_photo(photo, tilt))
        return list(warnings(replace(captured, photo=photo, measurements=seen)))

    (said,) = warned(clipped=np.ones_like(captured.photo.clipped))
    assert "100.0 % of the photograph is clipped. Lower the exposure" in said
    (said,) = warned(flash_fired=False)
    assert "did not fire" in said and "with the flash switched on" in said
    (said,) = warned(tilt=(0.0, -0.25))
    assert "tilted by 14 degrees" in said and "until it is parallel" in said


def test_keys_of_the_report_are_those_of_reference_and_schema(captured, tmp_path):
    write_report(captured, tmp_path / "report.json")
    check_report(tmp_path / "report.json")
    assert set(report_report(captured)) == set(report_keys())


def test_angles_are_in_degrees(captured):
    result = captured
    tilted = replace(result.material, setup=FlashSetup(tilt=(np.pi / 36, -np.pi / 18)))
    camera = report_report(replace(result, material=tilted))["camera"]
    assert camera["tilt_degrees"] == pytest.approx([5.0, -10.0])


def test_nan_and_infinity_become_null(captured, tmp_path):
    went = Tuning(((0.0, 1, float("inf")), (1.0, 2, float("nan"))))
    write_report(replace(captured, tuning=went), tmp_path / "report.json")

    def refuse(name: str) -> None:
        pytest.fail(f"{name} is not JSON")

    found = json.loads(Path(tmp_path / "report.json").read_text(), parse_constant=refuse)
    assert found["tuning"]["error"] is None
    assert found["tuning"]["error_over_time"][0] == {"seconds": 0.0, "step": 1, "error": None}


def test_the_effort_is_that_of_the_settings(captured):
    effort = {"preset": "standard", "steps": 0, "detail": 96}
    assert report_report(captured)["effort"] == effort
    asked = replace(captured.settings, generator="decoder", steps=5)
    decoder = replace(captured, settings=asked, tuning=Tuning(((1.0, 5, 0.5),)))
    more = {"steps": 5, "windows_per_step": 3, "matched": True}
    assert report_report(decoder)["effort"] == effort | more


def test_a_time_limit_that_overrides_the_preset_is_noted(captured):
    usual = report_report(captured)["notes"]
    assert not any("preset" in note for note in usual)
    limited = replace(captured, settings=CaptureSettings(preset="draft", time_limit=9.0))
    values = report_report(limited)
    assert values["effort"]["detail"] == 512
    (note,) = (note for note in values["notes"] if note not in usual)
    assert "the preset has no effect: the limit determines the texels" in note
    decoder = CaptureSettings(generator="decoder", time_limit=9.0)
    said = report_report(replace(captured, settings=decoder))["notes"]
    (note,) = (note for note in said if note not in usual)
    assert "at most 800 steps" in note
    counted = replace(captured, settings=replace(decoder, steps=5))
    assert report_report(counted)["notes"] == usual


# The commands on a real, if random, material, in a process of their own.

SYNTH = ("--size", "96x40", "--seed", "7", "--png", "-q", "-o")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small material."""
    folder = tmp_path_factory.mktemp("material")
    a_material("noise", across=512).save(folder / "noise.matcap")
    return folder


@pytest.fixture(scope="module")
def elsewhere(folder):
    """One process, as it takes seconds to start: the console script relights what it has made."""
    program = f"""
import sys
from matcap.cli.main import main, run
assert main(["synth", "noise.matcap", *{SYNTH}, "second"]) == 0
sys.argv[1:] = ["relight", "second", "--quiet", "--size", "64x48", "-o", "small.png"]
run()
"""
    command = [sys.executable, "-c", program]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_the_same_request_in_two_processes_gives_the_same_files(folder, matcap, elsewhere):
    assert matcap("synth", folder / "noise.matcap", *SYNTH, folder / "first").code == 0
    assert elsewhere.returncode == 0, elsewhere.stderr
    files = sorted(f.name for f in (folder / "first").iterdir())
    assert len(files) == 12
    for name in files:
        assert filecmp.cmp(folder / "first" / name, folder / "second" / name, shallow=False)


def test_reading_pictures_leaks_no_warning_at_exit(folder, elsewhere):
    """Python is not to skip at its end what OpenImageIO then would miss."""
    assert (elsewhere.returncode, elsewhere.stderr) == (0, "")
    assert (folder / "small.png").is_file()


def test_a_material_relights_without_a_map_set(matcap, folder):
    material, picture = folder / "noise.matcap", folder / "a.exr"
    assert matcap("relight", material, "--size", "40x30", "-o", picture).code == 0
    assert read_exr(picture).pixels.shape == (30, 40, 3)


def test_a_material_has_the_permissions_of_other_files(folder):
    (folder / "other").touch()
    assert (folder / "noise.matcap").stat().st_mode == (folder / "other").stat().st_mode
