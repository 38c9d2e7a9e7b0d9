"""`matcap-lab bench fronts` and `report`: what is run, skipped, drawn and said."""

import sys

import numpy as np
import pytest
from PIL import Image

from matcap.capture.settings import PRESETS
from matcap.errors import MatcapError, UsageError
from matcap_lab.bench import fronts
from matcap_lab.bench.fronts import (
    BASE,
    USUAL,
    WAYS,
    Fronts,
    command_of,
    command_spent,
    fronts_experiment,
    preset_ways,
)
from matcap_lab.bench.presentations import presentation_of
from matcap_lab.cli.main import main
from matcap_lab.experiment import clocked
from matcap_lab.experiment.page import BY_HAND, write_page
from matcap_lab.experiment.results import Trial, append, read
from matcap_lab.experiment.runner import run


@pytest.fixture
def captures(monkeypatch):
    """Nothing is photographed, captured or measured; gives what would have been captured."""
    asked = []

    def capture(name, way, out, at, seed):
        if name == "--time 10s":
            raise MatcapError("the command failed")
        asked.append((at(way.pixels), name, seed))
        return 2.0

    monkeypatch.setattr(fronts, "_capture", capture)
    monkeypatch.setattr(fronts, "_photographed", lambda specimen, *_: specimen.name)
    for name in ("spent", "verdicts", "sheet"):
        monkeypatch.setattr(fronts, name, lambda *_: {})
    monkeypatch.setattr(fronts, "errors", lambda _at, error: {"field": error})
    return asked


def measured(folder, ways, materials, **options):
    experiment = fronts_experiment(Fronts(folder, None, ways, materials, **options))
    return run(experiment, folder / "fronts.csv")


def test_every_preset_is_a_way_and_the_default_is_what_others_are_paired_with():
    ways = preset_ways()
    assert set(", ".join(ways.values()).split(", ")) == set(PRESETS)
    assert set(ways) <= set(USUAL)
    assert ways[BASE] == "draft, standard"


def test_a_sweep_goes_on_where_it_was_stopped_whatever_version_measured(captures, tmp_path):
    append(tmp_path / "fronts.csv", Trial("fronts", USUAL[0], "tile", {"field": 1.0}))
    found = measured(tmp_path, (*USUAL[:2], BASE), ["tile", "cloth"])
    assert len(captures) == 5 and len({one.key for one in found}) == 6
    measured(tmp_path, [BASE], ["tile"], seeds=(0, 5))
    assert captures[-1] == ("tile", BASE, 5) and len(captures) == 6


def test_more_photographs_than_are_taken_are_left_out(captures, tmp_path):
    measured(tmp_path, ["512 texels, 9 photographs"], ["tile", "granite"])
    assert [name for name, _, _ in captures] == ["granite"]


@pytest.mark.parametrize("asked", [{"ways": ["fast"]}, {"materials": ["wood"]}])
def test_unknown_names_are_told_with_the_known_ones(tmp_path, asked):
    with pytest.raises(UsageError, match="choose from"):
        fronts_experiment(Fronts(tmp_path, **asked))


def test_a_command_line_has_its_photographs_and_options(tmp_path):
    photographs = [tmp_path / f"{number}.dng" for number in range(5)]
    command = command_of("512 texels, 3 photographs", photographs, tmp_path, 7)
    assert command[3:7] == ["capture", *map(str, photographs[:3])]
    assert "--together" in command and command[command.index("--seed") + 1] == "7"


def test_memory_is_the_command_s_and_not_the_bench_s(capfd):
    held = np.ones((40_000_000,), np.float64)  # 320 MB in this process
    code = "import time; held = bytearray(60_000_000); time.sleep(0.2)"
    spent = command_spent([sys.executable, "-S", "-c", code])
    assert held.size and 55.0 < spent["megabytes"] < 200.0
    assert spent["clock"] >= 0.2 > 0.0 < spent["processor"]
    with pytest.raises(MatcapError, match="the command failed: no"):
        command_spent([sys.executable, "-c", "import sys; sys.exit('no')"])
    assert clocked.main([sys.executable, "-c", "raise SystemExit(3)"]) == 3


def some(path):
    best, worst = "1024 texels, 5 photographs", "decoder, 160 steps"
    for name, seconds, error in ((BASE, 30.0, 2.0), (best, 90.0, 1.2), (worst, 45.0, 3.0)):
        for subject, factor in (("leather", 1.0), ("asphalt10", 1.5)):
            values = {
                "seconds": seconds, "megabytes": 800.0, "field": factor * error,
                "exemplar": error, "flash": 1.0, "patches": 1.5, "filters": 4.0 - error,
                "verdict": "doubtful: dark", "seen": "good",
            }  # fmt: skip
            append(path, Trial("fronts", name, subject, values, WAYS[name].group, 0, "a machine"))


def written(table, page):
    return write_page({table: presentation_of(table)}, page, "matcap-lab bench report")


def test_the_page_says_what_is_on_the_front_and_keeps_what_is_by_hand(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "bench" / "fronts.csv", tmp_path / "docs" / "page.md"
    some(table)
    page.parent.mkdir()
    page.write_text(f"# Old\n\nGone.\n\n{BY_HAND}\n\nKept.\n")
    text = written(table, page)
    assert page.read_text() == text
    assert text.count(BY_HAND) == 1 and text.endswith("Kept.\n") and "Gone." not in text
    assert f"| * | {BASE} | draft, standard | 2 | 30.0 |" in text
    assert "|  | decoder, 160 steps |" in text
    assert "| asphalt10 | 3.00 | 1.80 | doubtful: dark | good |" in text
    with Image.open(table.with_suffix(".png")) as picture:
        assert picture.width > 600


def test_large_photographs_are_compared_with_no_others(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "fronts.csv", tmp_path / "page.md"
    some(table)
    name = "12 megapixels, 512 texels"
    large = Trial("fronts", name, "leather", {"seconds": 9.0, "field": 0.5}, "detail")
    append(table, large)
    text = written(table, page)
    assert f"| * | {BASE} |" in text and f"| * | {name}" not in text
    assert f"| leather | {name} | 9.00 | 0.500 |" in text
    alone = tmp_path / "alone.csv"
    append(alone, large)
    assert f"| * | {name} |" in written(alone, page)


def test_missing_empty_and_other_tables_are_told(tmp_path):
    page, table = tmp_path / "page.md", tmp_path / "table.csv"
    for _ in range(2):
        with pytest.raises(MatcapError, match="no rows stand in it"):
            written(table, page)
        table.touch()
    append(table, Trial("gloss", "+0 EV", "plain", {"off": 0.1}))
    with pytest.raises(MatcapError, match="bench gloss is not reported"):
        written(table, page)
    assert not page.exists()


WRITTEN = {"fronts", "relight", "tolerances"}  # tables that `bench report` presents


def test_what_was_measured_for_the_documentation_is_read():
    folder = __import__("pathlib").Path(__file__).parents[3] / "docs" / "bench"
    tables = sorted(folder.glob("*.csv"))
    result = {path.stem: presentation_of(path) for path in tables if path.stem in WRITTEN}
    assert set(result) == WRITTEN
    rows = read(folder / "fronts.csv")
    assert {row.configuration for row in rows} <= set(WAYS)
    assert all(0.5 < row.number("field") < 10.0 and row.number("seconds") > 1.0 for row in rows)


def test_the_command_lists_and_measures(captures, tmp_path, capsys):
    assert main(["bench", "fronts", "--list"]) == 0
    listed = capsys.readouterr().out
    assert BASE in listed and "material leather" in listed
    arguments = ["--point", BASE, "--material", "tile", "-o", str(tmp_path / "b")]
    assert main(["bench", "fronts", *arguments]) == 0
    assert "1 measurements" in capsys.readouterr().out
    (one,) = read(tmp_path / "b" / "fronts.csv")
    assert one.subject == "tile" and one.number("field") == 2.0
