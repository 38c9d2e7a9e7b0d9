"""Matching: a tuned material's mean and contrast are moved to the photograph's."""

import copy
from dataclasses import replace

import pytest
import torch
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take
from tuning import CODE, SETUP, start

from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.flash.plane import Plane, plane_of
from matcap.flash.render import render_rectified
from matcap.space.freeze import freeze
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.match import _Blocks, _gain, _shift, correction, match_photograph
from matcap.space.tuning.windows import shot_deviation
from matcap.statistics.encoding import fit_encoding, shading

WIDTH, HEIGHT = 256, 192
VALID = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
SHIFT = torch.tensor([0.3, -0.2, 0.1])


@pytest.fixture(scope="module")
def truth():
    """A material that is photographed."""
    decoder = start().requires_grad_(False)
    moments = tuple(freeze(decoder, CODE, ()))
    return TunedDecoder(decoder, CODE, moments, (), 2.0 / WIDTH).material("truth", SETUP)


def network(material):
    return material.part(TunedDecoder).decoder


@pytest.fixture(scope="module")
def photo(truth):
    return render_rectified(truth.maps(WIDTH, HEIGHT, seed=1), SETUP)


def spoilt(material, gain, shift):
    """The material with another contrast and another mean colour."""
    decoder = copy.deepcopy(network(material))
    bias = decoder.head.adain.affine.bias.data
    bias[:3] += torch.tensor(shift)
    bias[[6, 7, 8, 11]] *= gain
    tuned = replace(material.part(TunedDecoder), decoder=decoder)
    return tuned.material(material.name, material.setup)


def found(material, photo, valid=VALID, noise=None):
    return correction(material, plane_of(photo, valid, noise), seed=0)


def test_a_material_that_is_right_stays_as_it_is(truth, photo):
    right = found(truth, photo)
    assert right.gain == pytest.approx(1.0, abs=0.03)
    assert right.shift.abs().max() < 0.05


@pytest.mark.parametrize("gain", [0.7, 1.4])
def test_contrast_and_mean_are_found_again(truth, photo, gain):
    wrong = spoilt(truth, gain, SHIFT.tolist())
    moved = found(wrong, photo)
    assert moved.gain * gain == pytest.approx(1.0, abs=0.06)
    assert (moved.shift + SHIFT).abs().max() < 0.1


def test_the_matched_material_looks_like_the_photograph(truth, photo):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    matched = match_photograph(wrong, plane_of(photo, VALID))

    def values(picture):
        log = picture.log()
        return log.mean((1, 2)), (log - shading(log[None])[0]).std()

    def apart(material):
        (mean, contrast), (true_mean, true_contrast) = (
            values(p)
            for p in (render_rectified(material.maps(WIDTH, HEIGHT, seed=2), SETUP), photo)
        )
        return float((mean - true_mean).abs().max()), abs(float(contrast / true_contrast) - 1.0)

    mean_before, contrast_before = apart(wrong)
    mean, contrast = apart(matched)
    assert mean < 0.3 * mean_before
    assert contrast < 0.2 * contrast_before


def test_gloss_and_the_material_given_are_left_alone(truth, photo):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    before = copy.deepcopy(network(wrong).state_dict())
    matched = match_photograph(wrong, plane_of(photo, VALID))
    assert all(torch.equal(v, before[k]) for k, v in network(wrong).state_dict().items())
    old, new = (m.maps(64, 64) for m in (wrong, matched))
    assert torch.equal(old.specular, new.specular)
    assert torch.equal(old.roughness, new.roughness)
    assert not torch.allclose(old.diffuse, new.diffuse, atol=0.01)


def test_what_is_compared_is_what_is_made(truth, photo):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    moved = found(wrong, photo)
    old = wrong.maps(64, 64)
    new = match_photograph(wrong, plane_of(photo, VALID)).maps(64, 64)
    middle = network(wrong).head.adain.target(CODE)[0][:3, None, None]
    logit = middle + moved.gain * (old.diffuse.logit() - middle) + moved.shift[:, None, None]
    torch.testing.assert_close(new.diffuse, torch.sigmoid(logit), atol=1e-4, rtol=0.0)
    # The relief's mean, which nothing shows, may move.
    relief = new.height - new.height.mean()
    old_relief = old.height - old.height.mean()
    torch.testing.assert_close(relief, moved.gain * old_relief, atol=1e-5, rtol=0.0)


def test_the_sensors_noise_is_no_contrast_to_be_met(truth, photo):
    generator = torch.Generator().manual_seed(0)

    def hiss():
        drawn = torch.randn(3, HEIGHT, WIDTH, generator=generator)
        return 0.05 * drawn * shot_deviation(photo)

    noisy = (photo + hiss()).clamp_min(0.0)
    assert found(truth, noisy).gain > 1.08
    assert found(truth, noisy, noise=hiss()).gain == pytest.approx(1.0, abs=0.06)


def test_a_few_scratches_are_no_reason_for_more_contrast():
    """Nor are less of them one for less of everything."""
    blocks, even = _Blocks(VALID), torch.ones(3, HEIGHT, WIDTH)
    scratched = even.clone()
    scratched[..., :20, :] = 30.0
    assert _gain(scratched, even, blocks) == pytest.approx(1.0)
    assert _gain(even, scratched, blocks) == pytest.approx(1.0)
    assert _gain(1.44 * scratched, even, blocks) == pytest.approx(1.2, abs=1e-3)
    assert _gain(0.81 * even, scratched, blocks) == pytest.approx(0.9, abs=1e-3)


def test_blocks_count_by_their_share_of_diffuse_light():
    """A highlight brighter than the material's is no reason to brighten the diffuse albedo."""
    share = torch.full((3, HEIGHT, WIDTH), 0.8)
    share[..., : HEIGHT // 2, :] = 0.0
    apart = 0.2 * share
    lit = apart.clone()
    lit[..., : HEIGHT // 2, :] = 2.0
    expected = 0.2 * 0.64 / (0.64 + 2 * 0.1)
    for seen in (apart, lit):
        assert _shift(seen, share, torch.zeros(3), _Blocks(VALID)) == pytest.approx(
            [expected] * 3, rel=1e-3
        )


@pytest.mark.parametrize("unseen", ["invalid", "clipped"])
def test_nothing_moves_where_nothing_can_be_compared(truth, photo, unseen):
    valid = torch.zeros_like(VALID) if unseen == "invalid" else VALID
    picture = photo if unseen == "invalid" else torch.ones_like(photo)
    plane = Plane(picture, valid, None, fit_encoding(photo, VALID))
    nothing = correction(truth, plane, seed=0)
    assert nothing.gain == 1.0
    assert not nothing.shift.any()


def test_a_render_that_is_not_finite_changes_nothing(truth, photo):
    far = replace(truth, setup=SETUP.with_intensity((1e38,) * 3))
    nothing = found(far, photo)
    assert nothing.gain == 1.0
    assert not nothing.shift.any()


def test_a_capture_ends_with_it_but_for_drafts():
    setup = SETUP.with_intensity((3.0, 3.0, 3.0))
    shot = take(piece("leather", 1), PhoneCamera(128, 96, supersampling=1), setup)
    stages = {}
    for name, settings in (
        ("tuned", CaptureSettings(steps=2, detail=128, generator="decoder")),
        ("draft", CaptureSettings(preset="draft", steps=2, detail=128, generator="decoder")),
    ):
        result = capture_photo(as_photo(shot, 1, "leather.dng"), settings)
        stages[name] = "matching" in result.stage_seconds
        again = result.material.maps(*result.maps.size, seed=0)
        assert torch.equal(again.stacked(), result.maps.stacked())
    assert stages == {"tuned": True, "draft": False}


@pytest.mark.parametrize(
    "picture",
    [
        torch.zeros(3, HEIGHT, WIDTH),
        torch.full((3, HEIGHT, WIDTH), 0.2),
        torch.rand(3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(3)) ** 8,
    ],
    ids=["black", "even", "spots"],
)
def test_corrections_are_bounded_and_finite(truth, picture):
    far = found(truth, picture)
    assert 0.6 <= far.gain <= 1.7
    assert far.shift.abs().max() <= 1.0
    matched = match_photograph(truth, plane_of(picture, VALID))
    assert matched.maps(32, 32).stacked().isfinite().all()
