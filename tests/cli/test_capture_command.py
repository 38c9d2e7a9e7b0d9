"""`matcap capture`: its files, its messages, its exit codes; the capture itself is a fake."""

import errno
import json
import os

import pytest
from PIL import Image

from matcap.brdf.folder import mapset_files, read_mapset
from matcap.capture import outputs, preview, report
from matcap.errors import UsageError


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def test_all_outputs_stand_in_a_folder_of_the_photographs_name(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", "40x30", "--seed", 5)
    assert said.code == 0
    assert said.out == ""
    assert str(out / "leather") in said.err
    exrs = {name for name in mapset_files("leather") if not name.endswith(".png")}
    names = {f.name for f in (out / "leather").iterdir()}
    assert names == exrs | {"leather.matcap", "preview.png", "report.json"}
    maps, document = read_mapset(out / "leather")
    assert maps.size == (40, 30)
    assert document["seed"] == 5
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


def test_pngs_and_directx_normals(matcap, pipeline, photo, out):
    assert matcap("capture", photo, "-o", out, "--size", 16, "--png", "--normal", "dx").code == 0
    assert set(mapset_files("leather")) <= {f.name for f in (out / "leather").iterdir()}
    assert read_mapset(out / "leather")[1]["normal"] == "dx"


def test_the_preview_shows_eight_panels_and_their_crops(matcap, pipeline, photo, out):
    matcap("capture", photo, "-o", out, "--size", 16)
    with Image.open(out / "leather" / "preview.png") as sheet:
        assert sheet.mode == "RGB"
        assert sheet.width > 8 * 256
        # The photograph's panel: a quarter of full light is sRGB 137.
        assert sheet.getpixel((270, 200)) == (137, 137, 137)


def test_the_report_holds_what_was_done(matcap, pipeline, photo, out):
    options = ("--steps", 9, "--generator", "decoder")
    matcap("capture", photo, "-o", out, "--size", 16, *options)
    report = json.loads((out / "leather" / "report.json").read_text())
    assert report["settings"]["steps"] == 9
    tuning = report["tuning"]
    assert tuning["error"] == 0.5 and tuning["relative_error"] == 2.0
    assert report["error"] == {"exemplar": None, "field": None}  # too small a picture
    assert "flash did not fire" in report["verdict"]["sentence"]
    assert tuning["error_over_time"][0] == {"seconds": 0.5, "step": 1, "error": 0.9}
    assert report["stage_seconds"] == {"coarse fit": 0.5, "fine-tuning": 0.5}
    assert report["camera"]["tilt_degrees"] == [0.0, 0.0]
    assert report["photograph"]["clipped_share"] == 0.0
    assert {"matcap", "torch", "python"} <= set(report["versions"])


def test_the_verdict_is_said_and_a_strict_user_hears_it_in_the_exit_code(
    matcap, pipeline, photo, out
):
    said = matcap("capture", photo, "-o", out, "--size", 16)
    assert said.code == 0
    assert "failed: the photograph's middle is 1.0 times as bright as its border" in said.err
    assert "error" not in said.err
    again = ("--size", 16, "--strict", "--overwrite")
    assert matcap("capture", photo, "-o", out, *again).code == 3


def test_json_goes_to_stdout_and_alone(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", 16, "--json", "-q")
    (result,) = json.loads(said.out)["photographs"]
    assert said.err == ""
    assert result["status"] == "done"
    assert set(result["error"]) == {"exemplar", "field"}
    assert result["verdict"]["rating"] == "failed"  # even grey shows no flash
    assert result["material"] == str(out / "leather" / "leather.matcap")


def test_progress_is_plain_lines_where_there_is_no_terminal(matcap, pipeline, photo, out):
    said = matcap("capture", photo, "-o", out, "--size", 16)
    assert "index" in said.err
    assert "\x1b" not in said.err
    assert len(said.err.splitlines()) == 4  # two stages, what was made, the verdict


def test_what_was_noticed_when_reading_is_said(matcap, pipeline, photo, out):
    pipeline.notes = ("The file states no white balance: daylight (D65) assumed.",)
    said = matcap("capture", photo, "-o", out, "--size", 16, "--json")
    assert said.err.splitlines()[-1].strip() == pipeline.notes[0]
    assert json.loads(said.out)["photographs"][0]["notes"] == list(pipeline.notes)
    other = photo.with_name("b.dng")
    other.write_text("another photograph")
    said = matcap("capture", photo, other, "--together", "-o", out, "--size", 16, "--overwrite")
    assert f"b.dng: {pipeline.notes[0]}" in said.err


def test_photographs_of_the_same_stem_do_not_overwrite_each_other(matcap, pipeline, photo, out):
    other = photo.with_suffix(".JPG")
    other.write_text("another photograph")
    assert matcap("capture", photo, other, "-o", out, "--size", 16).code == 0
    assert sorted(f.name for f in out.iterdir()) == ["leather", "leather-2"]
    assert (out / "leather-2" / "leather-2.matcap").is_file()


def test_one_bad_photograph_is_3_and_leaves_nothing(matcap, tmp_path, out):
    said = matcap("capture", tmp_path / "none.dng", "-o", out)
    assert (said.code, said.out) == (3, "")
    assert said.err == f"matcap: {tmp_path / 'none.dng'}: there is no such file; check the name.\n"
    assert list(tmp_path.iterdir()) == []


def test_the_others_go_on_and_some_failed_is_4(matcap, pipeline, photo, tmp_path, out):
    empty = tmp_path / "empty.dng"
    empty.touch()
    said = matcap("capture", empty, photo, "-o", out, "--size", 16, "--json")
    assert said.code == 4
    assert "the file is empty; copy it again." in said.err
    results = json.loads(said.out)["photographs"]
    assert [result["status"] for result in results] == ["failed", "done"]
    assert [f.name for f in out.iterdir()] == ["leather"]


def test_an_interruption_saves_the_best_so_far_and_is_130(matcap, pipeline, photo, tmp_path, out):
    pipeline.interrupt = True
    said = matcap("capture", photo, photo, "-o", out, "--size", 16, "--json")
    assert said.code == 130
    (result,) = json.loads(said.out)["photographs"]  # the second one is not begun
    assert result["status"] == "interrupted"
    report = json.loads((out / "leather" / "report.json").read_text())
    assert report["interrupted"] is True
    assert "best so far" in report["warnings"][0]
    assert read_mapset(out / "leather")[0].size == (16, 16)


def test_an_early_interruption_is_130_and_leaves_nothing(matcap, pipeline, photo, tmp_path, out):
    pipeline.failure = KeyboardInterrupt()
    said = matcap("capture", photo, photo, "-o", out, "--json")
    assert said.code == 130
    assert said.err == f"matcap: {photo}: interrupted before there was anything to save.\n"
    assert [r["status"] for r in json.loads(said.out)["photographs"]] == ["interrupted"]
    assert list(tmp_path.iterdir()) == [photo]


def test_a_bug_is_1_with_one_sentence(matcap, pipeline, photo, tmp_path, out, monkeypatch):
    monkeypatch.delenv("MATCAP_DEBUG", raising=False)
    pipeline.failure = RuntimeError("shapes do not match")
    said = matcap("capture", photo, "-o", out, "-q")
    assert said.code == 1
    assert said.err.count("\n") == 1
    assert "internal error (RuntimeError: shapes do not match)" in said.err
    assert list(tmp_path.iterdir()) == [photo]


def test_a_wrong_setting_is_2_even_when_only_the_pipeline_knows(matcap, pipeline, photo, out):
    pipeline.failure = UsageError("no preset 'fast'", where="--preset", remedy="use draft")
    said = matcap("capture", photo, "-o", out, "-q")
    assert said.code == 2
    assert said.err == "matcap: --preset: no preset 'fast'; use draft.\n"


def test_the_folder_is_checked_before_any_work(matcap, pipeline, photo, tmp_path):
    said = matcap("capture", photo, "-o", photo / "out")
    assert said.code == 3
    assert "a file stands where a folder is needed; choose another folder with -o." in said.err
    said = matcap("capture", photo, "-o", tmp_path / "out", "--size", "100000000x10000")
    assert said.code == 3
    assert "are needed but the disk has" in said.err
    assert pipeline.calls == []
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
    assert said.code == 3
    assert said.err.count("\n") == 1
    assert "the disk is full; free some space or choose another folder with -o." in said.err
    assert list(tmp_path.iterdir()) == [photo]


def test_the_first_map_set_repeats_unless_its_size_cannot_which_is_said(
    matcap, pipeline, photo, out
):
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
        assert said.code == 3
        assert "this exists already" in said.err and "--overwrite" in said.err
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
