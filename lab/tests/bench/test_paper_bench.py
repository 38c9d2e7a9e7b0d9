"""`matcap-lab bench paper`: fine-tuning and crops, interpolation, generation, one table."""

from types import SimpleNamespace

import pytest
import torch
from materials import a_material

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.space.tuned import TunedDecoder
from matcap_lab.bench import paper
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
from matcap_lab.experiment.results import Trial, append, read
from matcap_lab.experiment.runner import run
from matcap_lab.measures.style import RandomFilters
from matcap_lab.simulate.specimen import EXAMPLES


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
