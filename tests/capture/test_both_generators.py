"""The decoder beside an exemplar: both in one material, the choice, and what Ctrl-C keeps."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.capture import both_generators
from matcap.capture.both_generators import choose
from matcap.capture.by_decoder import photograph_target
from matcap.capture.pipeline import capture_into, capture_photo
from matcap.capture.rectified import Method, Rectified, fit_photograph
from matcap.capture.report import read_report
from matcap.capture.settings import CaptureSettings, OutputSettings, RunStatus
from matcap.cli.main import main
from matcap.field.material import Material
from matcap.photo.load import load_photo
from matcap.space.prior.store import load_prior
from matcap.space.tuned import TunedDecoder
from matcap.statistics.compare import shading

PHOTO = Path(__file__).parents[2] / "examples/photos/tile.jpg"
DETAIL = 160
SETTINGS = CaptureSettings(detail=DETAIL)


@pytest.fixture
def short(monkeypatch):
    """One step of fine-tuning."""
    real = both_generators.TuneSettings
    monkeypatch.setattr(both_generators, "TuneSettings", lambda _steps, **given: real(1, **given))


def test_a_capture_has_both_generators_its_code_and_a_choice(tmp_path, short):
    folder = tmp_path / "tile"
    result = capture_into(folder, [PHOTO], SETTINGS, OutputSettings((32, 32)))
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


@pytest.mark.parametrize("asked", [{"generator": "example"}, {"preset": "draft"}])
def test_without_fine_tuning_there_is_an_exemplar_and_a_code(asked):
    photo = load_photo(PHOTO, long_side=DETAIL)
    result = capture_photo(photo, replace(SETTINGS, **asked))
    assert set(result.material.generators) == {"example"} and result.choice is None
    assert result.material.latent is not None and result.effort.steps == 0


def test_an_interrupt_keeps_the_material_by_example(monkeypatch):
    def interrupted(*_args, **_named):
        raise KeyboardInterrupt

    monkeypatch.setattr(both_generators, "tuned_decoder", interrupted)
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
    one, other = (
        MapSet(
            albedo,
            coarse.specular * flat,
            coarse.roughness * flat,
            0.0 * flat,
            texel_size=plane.texel_size,
        )
        for albedo in albedos
    )
    assert choose(one, other, target, plane).generator == "example"
    assert choose(other, one, target, plane).generator == "decoder"
    finer = other.stacked().repeat_interleave(2, 1).repeat_interleave(2, 2)
    flat_but_finer = MapSet.from_stacked(finer, other.texel_size / 2.0)
    assert choose(flat_but_finer, one, target, plane).generator == "example"
