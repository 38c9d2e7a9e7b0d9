"""The evaluator by random filters: another true piece is 1, and what differs is more."""

import pytest
import torch
import torch.nn.functional as F

from matcap_lab.bench.floors import photo_as_albedo
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator, relight_all
from matcap_lab.measures.style import RandomFilters, difference
from matcap_lab.simulate.photograph import PhoneCamera, as_photo
from matcap_lab.simulate.specimen import EXAMPLES

# Small and coarse, for speed: what is tested is order, not figures.
CAMERA = PhoneCamera(width=512, height=384, supersampling=1)
SETTINGS = EvaluationSettings(512, 192, CAMERA, finer=2, every=1, first=1001)


@pytest.fixture(scope="module")
def style():
    return RandomFilters()


@pytest.fixture(scope="module")
def shot():
    return EXAMPLES["leather"].take(CAMERA)


@pytest.fixture(scope="module")
def evaluator(style, shot):
    return Evaluator(EXAMPLES["leather"], shot.setup, SETTINGS, {"one": style})


def _pictures(evaluator, shot, material="leather"):
    """Another true piece, seen as the evaluator's."""
    size, blur = SETTINGS.size, CAMERA.blur * 2 * SETTINGS.detail / CAMERA.width
    maps = EXAMPLES[material].pieces(55)(2 * size, 2 * size, 1.0 / SETTINGS.detail)
    return relight_all(maps, shot.setup.intensity, evaluator.scene, size=(size, size), blur=blur)


@pytest.fixture(scope="module")
def truth(evaluator, shot):
    return _pictures(evaluator, shot)


def test_another_true_piece_scores_one(evaluator, truth):
    assert evaluator.style_ratio(truth) == pytest.approx(1.0, abs=0.25)


def test_blur_and_colour_are_noticed(evaluator, truth):
    right = evaluator.style_ratio(truth)
    kernel = torch.ones(3, 1, 5, 5) / 25
    blurred = F.conv2d(F.pad(truth, (2, 2, 2, 2), mode="reflect"), kernel, groups=3)
    recoloured = truth * torch.tensor([0.7, 1.0, 1.3])[:, None, None]
    darker = 0.7 * truth
    for wrong in (blurred, recoloured.clamp(0, 1), darker):
        assert evaluator.style_ratio(wrong) > 1.25 * right


def test_error_grows_towards_a_wrong_material(evaluator, truth, shot):
    wrong = _pictures(evaluator, shot, "plaster")
    errors = [
        evaluator.style_ratio(torch.lerp(truth, wrong, share)) for share in (0.0, 0.4, 0.7, 1.0)
    ]
    assert errors == sorted(errors)
    assert errors[-1] > 2.5


def test_black_pictures_compare(style):
    """A light below a bump's horizon may leave nothing; no division by zero."""
    size = SETTINGS.size
    generator = torch.Generator().manual_seed(2)
    speck = 1e-3 * torch.rand(1, 3, size, size, generator=generator)
    assert torch.isfinite(difference(style(speck), style(0.5 * speck))).all()


def test_photo_as_albedo_gives_the_photograph_back(shot):
    """Under its own flash its mean is right; that it bakes the flash in is what the bench shows."""
    photo = as_photo(shot, 1, "leather")
    captured = photo_as_albedo(photo, shot.setup, SETTINGS.detail)
    maps = captured.maps.crop(160, 96, 192, 192)
    assert maps.texel_size == 2.0 / SETTINGS.detail
    middle = torch.from_numpy(photo.pixels).permute(2, 0, 1)[:, 96:288, 160:352]
    assert float((maps.diffuse - middle).abs().mean()) < 0.05
