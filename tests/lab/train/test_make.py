"""`matcap prior make`: a folder of photographs to a prior, its branch and its card, end to end."""

import pytest
from small import jpeg

from matcap.errors import UsageError
from matcap.lab.train import make as recipe_room
from matcap.lab.train.make import make_prior
from matcap.lab.train.settings import read_config
from matcap.space.alignment import load_alignment
from matcap.space.prior.store import SHIPPED, load_prior

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
    monkeypatch.setattr("matcap.lab.train.pack.HELD_OUT", 2)  # twelve take half a minute
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
