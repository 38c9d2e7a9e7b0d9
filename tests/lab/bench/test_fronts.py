"""`matcap bench fronts`, `pairs` and `report`: what is run, skipped, looked at, drawn and said."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from matcap.capture.settings import PRESETS
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.field.material import Material
from matcap.files.note import Note
from matcap.lab.bench import clocked, fronts
from matcap.lab.bench.fronts import Fronts, run_fronts
from matcap.lab.bench.pairs import write_pairs
from matcap.lab.bench.paper import capture_as_in_paper
from matcap.lab.bench.report import BY_HAND, write_report
from matcap.lab.bench.table import Measurement, append, read
from matcap.lab.bench.ways import BASE, PAPER, USUAL, WAYS, preset_points
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import named_specimen, photograph


@pytest.fixture
def captures(monkeypatch):
    """Nothing is photographed, captured or judged; gives what would have been captured."""
    asked = []

    def measured(yard, bench, point, seed):
        if point == "--time 10s":
            raise MatcapError("the command failed")
        asked.append((yard, point, seed))
        return Measurement("capture", WAYS[point].group, point, yard, 5.0, 900.0, 2.0, seed=seed)

    monkeypatch.setattr(fronts, "_measured", measured)
    monkeypatch.setattr(fronts._Yard, "of", lambda specimen, pixels, bench: specimen.name)
    return asked


def test_every_preset_is_a_point_and_the_default_is_what_others_are_paired_with():
    points = preset_points()
    assert set(", ".join(points.values()).split(", ")) == set(PRESETS)
    assert set(points) <= set(USUAL)
    assert points[BASE] == "standard"
    assert PAPER in WAYS and PAPER not in USUAL


def test_a_sweep_goes_on_where_it_was_stopped(captures, tmp_path):
    run_fronts(Fronts(tmp_path, points=[BASE], materials=["tile"]))
    found = run_fronts(Fronts(tmp_path, points=USUAL[:2] + (BASE,), materials=["tile", "cloth"]))
    assert len(captures) == len(found) == len({one.key for one in found}) == 6
    run_fronts(Fronts(tmp_path, points=[BASE], materials=["tile"], seeds=(0, 5)))
    assert captures[-1] == ("tile", BASE, 5) and len(captures) == 7


def test_what_fails_is_told_and_no_line(captures, tmp_path):
    told = []
    found = run_fronts(
        Fronts(tmp_path, points=["--time 10s", BASE], materials=["tile"]), told.append
    )
    assert [one.point for one in found] == [BASE]
    assert "the command failed" in told[0]


def test_more_photographs_than_are_taken_are_left_out(captures, tmp_path):
    nine = "512 texels, 9 photographs"
    run_fronts(Fronts(tmp_path, points=[nine], materials=["tile", "granite"]))
    assert [yard for yard, _, _ in captures] == ["granite"]


@pytest.mark.parametrize("asked", [{"points": ["fast"]}, {"materials": ["wood"]}])
def test_unknown_names_are_told_with_the_known_ones(captures, tmp_path, asked):
    with pytest.raises(UsageError, match="choose from"):
        run_fronts(Fronts(tmp_path, **asked))
    assert captures == []


def test_a_command_line_has_its_photographs_and_options(tmp_path):
    point = "512 texels, 3 photographs"
    photographs = [tmp_path / f"{number}.dng" for number in range(5)]
    command = fronts._command(point, WAYS[point], photographs, tmp_path, 7)
    assert command[3:7] == ["capture", *map(str, photographs[:3])]
    assert "--together" in command and command[command.index("--seed") + 1] == "7"


def test_memory_is_the_command_s_and_not_the_bench_s(capfd):
    held = np.ones((40_000_000,), np.float64)  # 320 MB in this process
    code = "import time; held = bytearray(60_000_000); time.sleep(0.2)"
    spent = fronts._spent([sys.executable, "-S", "-c", code])
    assert held.size and 55.0 < spent["megabytes"] < 200.0
    assert spent["clock"] >= 0.2 > 0.0 < spent["processor"]
    with pytest.raises(MatcapError, match="the command failed: no"):
        fronts._spent([sys.executable, "-c", "import sys; sys.exit('no')"])
    assert clocked.main([sys.executable, "-c", "raise SystemExit(3)"]) == 3


def test_the_paper_s_form_is_a_decoder_from_nothing(tmp_path):
    specimen, camera = named_specimen("plaster"), PhoneCamera(160, 120, supersampling=1)
    photo, _ = photograph(specimen, camera, tmp_path)
    capture_as_in_paper(photo, tmp_path / "paper.matcap", 0, steps=1)
    found = Material.load(tmp_path / "paper.matcap")
    assert set(found.generators) == {"decoder"}
    assert found.provenance["settings"]["prior"] == "none"


def some(path):
    best, worst = "1024 texels, 5 photographs", "decoder, 160 steps"
    for point, seconds, error in ((BASE, 30.0, 2.0), (best, 90.0, 1.2), (worst, 45.0, 3.0)):
        for subject, factor in (("leather", 1.0), ("asphalt10", 1.5)):
            one = Measurement(
                "capture", WAYS[point].group, point, subject, seconds, 800.0, factor * error,
                piece=error, fine=error, flash=1.0, patches=1.5, filters=4.0 - error,
                machine="a machine", verdict="doubtful: dark", seen="good",
            )  # fmt: skip
            append(path, one)


def test_a_picture_without_sheets_is_no_surprise(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table = tmp_path / "fronts.csv"
    some(table)
    with pytest.warns(Note, match="no sheets lie in .*leather, so .*fronts.png shows none: copy"):
        write_report([table], tmp_path / "page.md", ["matcap", "bench", "report"])
    assert table.with_suffix(".png").is_file()


def test_the_page_says_what_is_on_the_front_and_keeps_what_is_by_hand(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "bench" / "fronts.csv", tmp_path / "docs" / "page.md"
    some(table)
    sheets = table.parent / "sheets" / "leather"
    sheets.mkdir(parents=True)
    for name in ("truth", BASE):
        Image.new("RGB", (64, 128), "red").save(sheets / f"{name}.png")
    (table.parent / "pairs.csv").write_text(
        "pair,material,left,right,nearer\n"
        f'1,leather,"{BASE}","decoder, 160 steps",left\n'
        f'2,asphalt10,"decoder, 160 steps","{BASE}",neither\n'
    )
    relight = tmp_path / "relight.json"
    scene = {"scene": "noon", "effects": 3, "automatic_s": 0.1, "all_s": 0.4, "ratio": 4.0}
    relight.write_text(
        json.dumps({"megapixel_wall_ms": 50.0, "median_ratio": 4.0, "scenes": [scene]})
    )
    page.parent.mkdir()
    page.write_text(f"# Old\n\nGone.\n\n{BY_HAND}\n\nKept.\n")
    text = write_report([table, relight], page, ["matcap", "bench", "report"])
    assert page.read_text() == text
    assert text.count(BY_HAND) == 1 and text.endswith("Kept.\n") and "Gone." not in text
    assert f"| * | {BASE} | standard | 2 | 30 |" in text
    assert f"preset `standard` ({BASE}): dominated by no other point of one photograph." in text
    assert "|  | decoder, 160 steps |" in text
    assert "| **mean of real sets** | 3.00 | 2.00 | 1.80 | 1.20 |" in text
    assert "| SqueezeNet | 1 of 1 | 100% | 1 of 1 | 100% |" in text
    assert "| filters | 0 of 1 | 0% | 0 of 1 | 0% |" in text
    assert "| SqueezeNet, own flash | 0 of 1 | 0% | 0 of 0 | 0% |" in text
    assert "in 1 of them one was nearer" in text
    assert "| noon | 3 | 0.100 | 0.400 | 4.0 |" in text
    with Image.open(table.with_suffix(".png")) as picture:
        assert picture.width > 600


def test_a_dominated_preset_is_named(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "fronts.csv", tmp_path / "page.md"
    some(table)
    quicker = replace(read(table)[0], point="512 texels, 0 steps", seconds=9.0, error=0.5)
    append(table, quicker)
    append(table, replace(quicker, subject="asphalt10"))
    assert f"({BASE}): dominated by 512 texels, 0 steps." in write_report([table], page, ["x"])


def test_large_photographs_are_compared_with_no_others(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "fronts.csv", tmp_path / "page.md"
    some(table)
    large = replace(
        read(table)[0], point="12 megapixels, 512 texels", group="detail", seconds=9.0, error=0.5
    )
    append(table, large)
    text = write_report([table], page, ["x"])
    assert f"({BASE}): dominated by no other point of one photograph." in text
    assert "| leather | 12 megapixels, 512 texels | 9 | 800 | 0.50 | 2.00 | 2.00 | 1.00 |" in text
    alone = tmp_path / "alone.csv"
    append(alone, large)
    assert "| * | 12 megapixels, 512 texels |" in write_report([alone], page, ["x"])


def test_five_photographs_are_told_of_on_the_finer_texels(tmp_path):
    """In whatever order they were measured."""
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "fronts.csv", tmp_path / "page.md"
    some(table)
    for texels, error in ((1024, 1.25), (512, 1.75)):
        point = f"{texels} texels, 5 photographs"
        append(table, replace(read(table)[0], point=point, group="several", error=error))
    worst = write_report([table], page, ["x"]).partition("### The ten worst")[2]
    assert "| 1.25, " in worst and "| 1.75, " not in worst


def test_missing_and_empty_tables_are_told(tmp_path):
    with pytest.raises(MatcapError, match="no such table"):
        write_report([tmp_path / "none.csv"], tmp_path / "page.md", ["matcap"])
    empty = tmp_path / "empty.csv"
    empty.touch()
    with pytest.raises(MatcapError, match="the table is empty"):
        write_report([empty], tmp_path / "page.md", ["matcap"])
    odd = tmp_path / "odd.json"
    odd.write_text("[]")
    with pytest.raises(MatcapError, match="not what matcap bench relight"):
        write_report([odd], tmp_path / "page.md", ["matcap"])
    assert not (tmp_path / "page.md").exists()


def test_pairs_are_of_one_material_without_names(tmp_path):
    for material in ("leather", "tile"):
        folder = tmp_path / "sheets" / material
        folder.mkdir(parents=True)
        for name in ("truth", "a", "b", "c", "a, seed 1"):
            Image.new("RGB", (32, 64)).save(folder / f"{name}.png")
    lines = write_pairs(tmp_path, tmp_path / "out", 40, 0).read_text().splitlines()
    assert lines[0] == "pair,material,left,right,nearer"
    assert len(lines) == 7  # three pairs of each material, and no more
    assert not any("truth" in line or "seed" in line for line in lines)
    with Image.open(tmp_path / "out" / "page-1.png") as page:
        assert page.height == 5 * (32 + 16)
    with pytest.raises(MatcapError, match="no captures"):
        (tmp_path / "none" / "sheets").mkdir(parents=True)
        write_pairs(tmp_path / "none", tmp_path / "out", 4, 0)


def test_the_command_lists_and_measures(captures, tmp_path, capsys):
    assert main(["bench", "fronts", "--list"]) == 0
    listed = capsys.readouterr().out
    assert BASE in listed and "material leather" in listed
    arguments = ["--point", BASE, "--material", "tile", "-o", str(tmp_path / "b")]
    assert main(["bench", "fronts", *arguments]) == 0
    assert "1 measurements" in capsys.readouterr().out
    (one,) = read(tmp_path / "b" / "fronts.csv")
    assert one.subject == "tile" and math.isnan(one.piece)
