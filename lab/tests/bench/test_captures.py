"""`matcap-lab bench fronts` and `report`: what is run, skipped, drawn and said."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from materials import a_material
from PIL import Image

from matcap.brdf.maps import MapSet
from matcap.capture.settings import EXEMPLAR_STAGES, PRESETS
from matcap.errors import MatcapError, UsageError
from matcap.flash.geometry import FlashSetup
from matcap.space.tuned import TunedDecoder
from matcap_lab.bench import fronts, paper, profile
from matcap_lab.bench.fronts import (
    BASE,
    USUAL,
    WAYS,
    Fronts,
    command_of,
    command_spent,
    fronts_experiment,
    presentation_of,
    preset_ways,
)
from matcap_lab.bench.paper import (
    CROP,
    LINEAR,
    PaperSubject,
    crop,
    finetuned_as_in_paper,
    generation,
    interpolation,
    paper_page,
    random_features,
)
from matcap_lab.cli.main import main
from matcap_lab.experiment import clocked
from matcap_lab.experiment.page import BY_HAND, write_page
from matcap_lab.experiment.results import Trial, append, read
from matcap_lab.experiment.runner import run
from matcap_lab.measures.style import RandomFilters
from matcap_lab.simulate.specimen import EXAMPLES


@pytest.fixture
def captures(monkeypatch):
    """Nothing is photographed, captured or measured; gives what would have been captured."""
    asked = []

    def capture(name, way, out, at, seed):
        asked.append((at(way.pixels), name, seed))
        return 2.0

    monkeypatch.setattr(fronts, "_capture", capture)
    monkeypatch.setattr(fronts, "_photographed", lambda specimen, *_: specimen.name)
    for name in ("spent", "verdicts"):
        monkeypatch.setattr(fronts, name, lambda *_: {})
    monkeypatch.setattr(fronts, "errors", lambda _at, error: {"field": error})
    return asked


def measured(folder, ways, materials, **options):
    experiment = fronts_experiment(Fronts(folder, None, ways, materials, **options))
    return run(experiment, folder / "fronts.csv")


def test_every_preset_is_a_way_and_draft_is_what_others_are_paired_with():
    ways = preset_ways()
    assert sorted(ways.values()) == sorted(PRESETS) and set(ways) <= set(USUAL)
    assert ways[BASE] == "draft" and ways["default"] == "standard"


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
    command = command_of("1024 texels, JPEG, two exposures", photographs[:2], tmp_path, 0)
    assert command[4:6] == [*map(str, photographs[:2])] and "--together" not in command


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
    assert f"| * | {BASE} | draft | 2 | 30.0 |" in text
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


# `matcap-lab bench paper`: fine-tuning and crops, interpolation, generation, one table.


def drawing(monkeypatch, *numbers):
    """A generator's numbers are these: place and scale of a crop."""
    monkeypatch.setattr(torch, "rand", lambda *_, **__: torch.tensor(numbers))


def test_crops_are_of_one_place_and_scale_and_go_on_by_reflection(monkeypatch):
    x = torch.linspace(0.0, 1.0, 64).expand(1, 3, 48, 64)
    y = torch.linspace(0.0, 1.0, 48)[:, None].expand(1, 3, 48, 64)
    drawing(monkeypatch, 0.0, 0.0, 0.0)  # a tenth of a texel a pixel, from the first texel
    across, down = crop(torch.cat([x, y]), torch.Generator())
    assert across.shape == (3, CROP, CROP)
    torch.testing.assert_close(across[0, 0], 0.1 * torch.arange(CROP) / 63.0, atol=1e-4, rtol=0.0)
    torch.testing.assert_close(down[0, :, 0], 0.1 * torch.arange(CROP) / 47.0, atol=1e-4, rtol=0.0)
    drawing(monkeypatch, 0.0, 0.0, 0.9 / 7.9)  # a texel a pixel: back from the last one
    (back,) = crop(x, torch.Generator())
    assert back[0, 0].argmax() in (63, 64) and back[0, 0, 100] < back[0, 0, 70]
    drawing(monkeypatch, 0.5, 0.5, 1.0)  # eight texels a pixel: blurred before
    assert 0.1 < float(crop((x * 1e3).frac(), torch.Generator()).std()) < 0.27


@pytest.fixture
def untuned():
    torch.manual_seed(0)
    shade = 0.2 + 0.1 * torch.rand(48, 64, 1)
    return SimpleNamespace(
        material=a_material(across=64), rectified=shade.expand(-1, -1, 3).contiguous().numpy()
    )


def test_the_paper_s_fine_tuning_changes_weights_alone_and_comes_nearer(untuned, monkeypatch):
    monkeypatch.setattr(paper, "CROP", 64)
    monkeypatch.setattr(paper, "SCALES", (0.9, 1.1))
    losses, difference = [], paper._difference

    def noted(*given):
        losses.append(difference(*given))
        return losses[-1]

    monkeypatch.setattr(paper, "_difference", noted)
    before = untuned.material.part(TunedDecoder)
    after = finetuned_as_in_paper(untuned, random_features(), 0, 60).part(TunedDecoder)
    first, last = ([float(loss.detach()) for loss in some] for some in (losses[:10], losses[-10:]))
    assert len(losses) == 60 and sum(last) < 0.8 * sum(first)
    assert torch.equal(before.code, after.code) and not after.waves and after.drawing is None
    changed = [
        not torch.equal(one, other)
        for one, other in zip(before.decoder.parameters(), after.decoder.parameters(), strict=True)
    ]
    assert any(changed) and not after.decoder.training


class Bench:
    """An evaluator that takes maps as they are."""

    styles = {"style": RandomFilters()}
    own_scene = None

    def side(self, _texel_size):
        return 64

    def relit(self, maps, _intensity, _scene):
        return maps.diffuse[None].float()


def flat(colour):
    """A material of one colour."""

    def maps(width, height):
        plane = torch.full((1, height, width), 0.5)
        return MapSet(colour * torch.ones(3, height, width), plane, plane, plane, 1 / 32)

    return SimpleNamespace(texel_size=1 / 32, maps=maps, setup=FlashSetup())


def test_steps_go_from_one_material_to_the_other(tmp_path):
    made = {"a": flat(0.2), "b": flat(0.4), "c": flat(0.9)}
    drawn = {name: a_material(name, seed) for seed, name in enumerate(made)}
    prepared = {name: (lambda name=name: PaperSubject(tmp_path / name, Bench())) for name in made}
    captured = {
        LINEAR: lambda one, _seed: (made[one.path.name], 1.0),
        "FULL": lambda one, _seed: (drawn[one.path.name], 1.0),
    }
    rows = run(interpolation(prepared, captured, None), tmp_path / "paper.csv")
    assert {row.subject for row in rows} == {"a to b", "b to c", "c to a"} and len(rows) == 6
    for row in rows:
        middle, longest = row.number("middle, style"), row.number("longest step, style")
        if row.configuration == LINEAR:  # of means from 0.2 to 0.4: |a - b| / mean
            assert 0.5 < middle < 0.75 and 0.25 < longest < middle
        assert middle > 0.3 and longest >= 0.25
    assert not interpolation(dict(list(prepared.items())[:1]), captured, None).subjects


def test_draws_like_the_map_sets_are_as_near_and_as_far_apart_as_they_are(monkeypatch, tmp_path):
    sets = [EXAMPLES[name] for name in ("leather", "granite", "plaster")]
    monkeypatch.setattr(paper, "DRAWS", 3)

    def values(drawn):
        monkeypatch.setattr(paper, "lit", lambda number: drawn[number])
        monkeypatch.setattr(
            paper, "load_prior", lambda: SimpleNamespace(draw=lambda number: number)
        )
        experiment = generation(sets, {"style": RandomFilters()}, None)
        (subject,) = (prepare() for prepare in experiment.subjects.values())
        real.extend(subject[: 3 - len(real)])
        made = experiment.configurations["sample"].run(subject, 0)
        return experiment.measures[0](subject, made)

    real = []
    values([torch.zeros(3, 256, 256)] * 3)
    same, one = values(real), values(real[:1] * 3)
    assert same["nearest, style"] == pytest.approx(0.0, abs=1e-5)
    assert same["spread, style"] == pytest.approx(1.0, abs=1e-4)
    assert one["spread, style"] == pytest.approx(0.0, abs=1e-4)


def test_one_command_measures_what_is_asked_for(tmp_path, monkeypatch, capsys):
    sets = tmp_path / "sets"
    sets.mkdir()
    monkeypatch.setattr(paper, "_compared", lambda *_: {"style, relit": 0.5})
    monkeypatch.setattr(paper, "photograph", lambda *_: (tmp_path, SimpleNamespace(setup=0)))
    monkeypatch.setattr(paper, "Evaluator", lambda *_: None)
    asked = ["--material", "leather", "--configuration", "FULL", "--configuration", "GRAM"]
    assert main(["bench", "paper", str(sets), "-o", str(tmp_path / "out"), *asked]) == 0
    rows = read(tmp_path / "out" / "paper.csv")
    assert [row.configuration for row in rows] == ["FULL", "GRAM"]
    page = capsys.readouterr().out
    assert "| FULL | 1 | 0.500 |" in page and "| GRAM | 0.500 | +0.0 % | not measured |" in page
    walk = Trial("interpolation", "FULL", "leather to leather", {"middle, NSD": 0.7})
    append(tmp_path / "out" / "paper.csv", walk)
    page = paper_page(read(tmp_path / "out" / "paper.csv"), "")  # each table has its own columns
    assert "| FULL | 1 | 0.700 |" in page and "| FULL | 1 | 0.500 |" in page


# The profile of a capture has every stage, and its stages make up the whole.

PHOTOS = Path(__file__).parents[3] / "examples/photos"
PROFILE = ["bench", "profile", "--preset", "instant"]


def test_stages_make_up_the_whole(tmp_path):
    small = cv2.resize(cv2.imread(str(PHOTOS / "tile.jpg")), (320, 240))
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
from matcap.capture.settings import CaptureProgress
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
