"""A folder of photographs to a prior, end to end, and standardised codes."""

import pytest
import torch
from packs import jpeg
from small import SMALL

from matcap.errors import UsageError
from matcap.space.alignment import load_alignment
from matcap.space.prior.base import base_of
from matcap.space.prior.store import SHIPPED, load_prior
from matcap_lab.train import finish as recipe_room
from matcap_lab.train.finish import codes_of, finish, make_prior, standardise, with_anchors
from matcap_lab.train.step import fields
from matcap_lab.train.training import read_config

RECIPE = """
steps = 2
materials = 1
places = 1
window = 64
report_every = 2
encoder = { width = 64 }
decoder = { noise_channels = 4, widths = [8, 8, 8, 8, 8], convolutions = [1, 1] }

[corpus]
simulated = 1

[alignment]
materials = 1
steps = 1
fused = 1
"""


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE)
    return path


def test_it_goes_from_photographs_to_a_prior_and_is_not_done_twice(tmp_path, recipe, monkeypatch):
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    monkeypatch.setattr("matcap_lab.train.corpus.HELD_OUT", 2)  # twelve take half a minute
    monkeypatch.setattr("matcap_lab.train.alignment._STEPS", 60)  # three thousand take five seconds
    for index in range(3):
        (photographs / f"m{index}_a.jpg").write_bytes(jpeg(index))
    out = tmp_path / "mine.safetensors"
    made = make_prior(photographs, recipe, out)
    assert load_prior(out).about["steps"] == 2 and made.anchors is not None
    assert load_alignment(out.with_suffix("") / "alignment.safetensors") is not None
    card = out.with_suffix(".md").read_text()
    assert "1 photographs and 1 simulated ones; 2 held out" in card and "steps = 2" in card
    bits = out.read_bytes()
    for done in ("build", "train_branch"):
        monkeypatch.setattr(recipe_room, done, None)
    make_prior(photographs, recipe, out)
    assert out.read_bytes() == bits


@pytest.mark.parametrize(
    ("line", "why"),
    [("[corpus]\nfaked = 3", "'faked'"), ("[alignment]\nsteps = -1", "'steps'"), ("x = ", "read")],
)
def test_a_wrong_recipe_is_told(tmp_path, line, why):
    path = tmp_path / "recipe.toml"
    path.write_text(line)
    with pytest.raises(UsageError, match=why):
        make_prior(None, path, tmp_path / "prior.safetensors")


def test_the_recipe_that_comes_along_is_one(tmp_path):
    text = (SHIPPED.parent / "make.toml").read_text()
    (tmp_path / "training.toml").write_text(text[: text.index("[corpus]")])
    assert read_config(tmp_path / "training.toml").steps == 17200


def test_standardising_changes_codes_and_no_picture(prior, pack):
    entries = pack.entries[:3]
    torch.nn.init.normal_(prior.encoder.head.weight, std=0.3)
    codes = codes_of(prior.encoder, entries)
    encoder, decoder = standardise(prior.encoder, prior.decoder, codes)
    after = codes_of(encoder, entries)
    mean, variance = after.aggregate
    torch.testing.assert_close(mean, torch.zeros(64), atol=1e-3, rtol=0)
    torch.testing.assert_close(variance, torch.ones(64), atol=1e-3, rtol=0)
    assert torch.allclose(after.mean, codes.standardised().mean, atol=1e-3)
    field = fields(SMALL, [()], 32, 1, "cpu")
    with torch.no_grad():
        before_picture = prior.decoder(field, codes.mean[0])
        after_picture = decoder(field, after.mean[0])
    torch.testing.assert_close(after_picture, before_picture, atol=1e-3, rtol=1e-3)


def test_a_finished_prior_knows_its_codes(prior, pack):
    done = finish(prior.encoder, prior.decoder, pack.entries[:3], {"steps": 1})
    assert done.about["steps"] == 1
    assert len(done.about["code_mean"]) == len(done.about["code_variance"]) == 64
    assert 0 <= done.about["dead_dimensions"] <= 64
    assert bool(torch.isfinite(done.draw(1).maps(32, 32).stacked()).all())
    assert done.anchors is not None and len(done.anchors) == 3


def test_draws_of_an_older_prior_are_led_to_photographs(prior, pack):
    entries = pack.entries[-3:]
    codes = codes_of(prior.encoder, entries)
    led = with_anchors(prior, entries)
    assert led.anchors is not None
    for index, entry in enumerate(entries):
        anchor = led.anchors[index]
        torch.testing.assert_close(anchor.code, codes.mean[index])
        assert len(anchor.waves) == len(entry.waves)
        base = led.conditional_mean.base(anchor.code, anchor.rest)
        wanted = base_of(entry.coarse, entry.contrast)
        torch.testing.assert_close(base.mean[:5], wanted.mean[:5], atol=1e-4, rtol=1e-4)
