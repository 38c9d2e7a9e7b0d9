"""Matching to the photograph, and windows of it."""

import copy
from dataclasses import replace

import pytest
import torch
from tuning import CODE, SETUP, WINDOW, photograph, scene, start, tune
from uniform import a_setup
from uniform import photograph as uniform

from matcap.flash.geometry import plane_points
from matcap.flash.light import render_rectified
from matcap.flash.rectify import Plane, plane_of, read_plane, rectify
from matcap.space.freeze import freeze
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.match import (
    _best_scale,
    _Blocks,
    _gain,
    _shift,
    correction,
    cut_windows,
    match_photograph,
    shot_deviation,
    with_noise,
)
from matcap.statistics.compare import (
    FilterBank,
    FilterBankConfig,
    Weights,
    describe,
    distance,
    fit_encoding,
    shading,
)

# Matching: a tuned material's mean and contrast are moved to the photograph's.


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


def found(material, photo, valid=VALID, noise=None, setup=SETUP):
    mean, _ = network(material).head.adain.target(CODE)
    turned = int(material.setup.turned)
    maps = material.maps(*((HEIGHT, WIDTH) if turned else (WIDTH, HEIGHT)), seed=0).turned(turned)
    with torch.inference_mode():
        return correction(maps, mean, setup, plane_of(photo, valid, noise))


def test_a_matching_material_is_unchanged(truth, photo):
    right = found(truth, photo)
    assert right.gain == pytest.approx(1.0, abs=0.03) and right.shift.abs().max() < 0.05


@pytest.mark.parametrize("gain", [0.7, 1.4])
def test_contrast_and_mean_are_recovered(truth, photo, gain):
    wrong = spoilt(truth, gain, SHIFT.tolist())
    moved = found(wrong, photo)
    assert moved.gain * gain == pytest.approx(1.0, abs=0.06)
    assert (moved.shift + SHIFT).abs().max() < 0.1


def test_the_matched_material_looks_like_the_photograph(truth, photo):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    matched, _ = match_photograph(wrong, plane_of(photo, VALID))

    def values(picture):
        log = picture.log()
        return log.mean((1, 2)), (log - shading(log[None])[0]).std()

    true_mean, true_contrast = values(photo)

    def apart(material):
        shown = render_rectified(material.maps(WIDTH, HEIGHT, seed=2), SETUP)
        mean, contrast = values(shown)
        return float((mean - true_mean).abs().max()), abs(float(contrast / true_contrast) - 1.0)

    mean_before, contrast_before = apart(wrong)
    mean, contrast = apart(matched)
    assert mean < 0.3 * mean_before and contrast < 0.2 * contrast_before


def test_gloss_and_the_given_material_are_unchanged(truth, photo):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    before = copy.deepcopy(network(wrong).state_dict())
    matched, _ = match_photograph(wrong, plane_of(photo, VALID))
    assert all(torch.equal(v, before[k]) for k, v in network(wrong).state_dict().items())
    old, new = (m.maps(64, 64) for m in (wrong, matched))
    assert torch.equal(old.specular, new.specular) and torch.equal(old.roughness, new.roughness)
    assert not torch.allclose(old.diffuse, new.diffuse, atol=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_the_matched_material_has_the_compared_maps(truth, photo, turned):
    wrong = spoilt(truth, 0.7, SHIFT.tolist())
    size = (HEIGHT, WIDTH) if turned else (WIDTH, HEIGHT)
    wrong = wrong.part(TunedDecoder).material("", replace(SETUP, turned=turned))
    moved, old = found(wrong, photo), wrong.maps(*size)
    matched, maps = match_photograph(wrong, plane_of(photo, VALID))
    assert maps.size == size
    new = matched.maps(*size)
    torch.testing.assert_close(maps.diffuse, new.diffuse, atol=1e-4, rtol=0.0)
    middle = network(wrong).head.adain.target(CODE)[0][:3, None, None]
    logit = middle + moved.gain * (old.diffuse.logit() - middle) + moved.shift[:, None, None]
    torch.testing.assert_close(new.diffuse, torch.sigmoid(logit), atol=1e-4, rtol=0.0)
    # The relief's mean, which nothing shows, may move.
    for height in (new.height, moved.gain * old.height):
        relief = maps.height - maps.height.mean()
        torch.testing.assert_close(relief, height - height.mean(), atol=1e-5, rtol=0.0)


def test_sensor_noise_is_not_matched_as_contrast(truth, photo):
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
    expected = pytest.approx([0.2 * 0.64 / (0.64 + 2 * 0.1)] * 3, rel=1e-3)
    for seen in (apart, lit):
        assert _shift(seen, share, torch.zeros(3), _Blocks(VALID)) == expected


@pytest.mark.parametrize("unseen", ["invalid", "clipped"])
def test_without_valid_windows_nothing_changes(truth, photo, unseen):
    valid = torch.zeros_like(VALID) if unseen == "invalid" else VALID
    picture = photo if unseen == "invalid" else torch.ones_like(photo)
    nothing = found(truth, picture, valid)
    assert nothing.gain == 1.0 and not nothing.shift.any()


def test_a_render_that_is_not_finite_changes_nothing(truth, photo):
    nothing = found(truth, photo, setup=SETUP.with_intensity((1e38,) * 3))
    assert nothing.gain == 1.0 and not nothing.shift.any()


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
    assert 0.6 <= far.gain <= 1.7 and far.shift.abs().max() <= 1.0
    matched, _ = match_photograph(truth, plane_of(picture, VALID))
    assert matched.maps(32, 32).stacked().isfinite().all()


# Windows cover the picture and keep their place.


BANK = FilterBank(FilterBankConfig(sizes=(3,), filters=4, levels=2))
WIDE, HIGH, SIZE = 96, 64, 32


def cut(valid=None, *, size=SIZE, width=WIDE, height=HIGH):
    """A picture whose brightness tells where it was cut, and its windows."""
    generator = torch.Generator().manual_seed(0)
    slope = torch.linspace(0.1, 0.9, width) * torch.linspace(0.5, 1.0, height)[:, None]
    linear = slope * torch.exp(0.1 * torch.randn(3, height, width, generator=generator))
    valid = torch.ones(height, width, dtype=torch.bool) if valid is None else valid
    plane = plane_of(linear, valid)
    return linear, plane.encoding, cut_windows(plane, BANK, size)


def corners(windows, width=WIDE, height=HIGH):
    """(column, row) of every window's left top texel, from its plane points."""
    first = windows.points[:, :2, 0, 0]
    column = (first[:, 0] + 1.0) * width / 2.0 - 0.5
    row = height / 2.0 - first[:, 1] * width / 2.0 - 0.5
    return [(round(x), round(y)) for x, y in zip(column.tolist(), row.tolist(), strict=True)]


def test_every_window_has_the_points_and_the_picture_of_its_own_place():
    linear, encoding, windows = cut()
    for index, (x, y) in enumerate(corners(windows)):
        expected = plane_points(x, y, SIZE, SIZE, (WIDE, HIGH), dtype=torch.float32)
        assert torch.allclose(windows.points[index], expected, atol=1e-6)
        here = describe(linear[None, :, y : y + SIZE, x : x + SIZE], encoding, BANK)
        target = windows.target.select([index])
        assert torch.equal(target.mean, here.mean)
        unraised = Weights(gram=0.0, cross=0.0, histogram=0.0)
        assert float(distance(target, here, unraised)) < 1e-5
        for kind in ("grams", "crosses", "quantiles"):
            for raised, plain in zip(getattr(target, kind), getattr(here, kind), strict=True):
                scale = float((raised * plain).sum() / plain.square().sum())
                assert 1.0 <= scale <= 1.0 / 0.7 + 1e-6
                torch.testing.assert_close(raised, scale * plain, atol=1e-5, rtol=1e-4)


def test_the_best_scale_is_where_the_distance_is_least():
    generator = torch.Generator().manual_seed(2)
    found, target = ((0.5 * torch.randn(6, 5, 5, generator=generator)).exp() for _ in range(2))
    found[0, 0, 0] = 0.0
    size = target.abs().flatten(1).mean(dim=1)

    def cost(scale):
        return float(((scale * found - target).abs().flatten(1).mean(dim=1) / size).mean())

    best = _best_scale(found, target)
    assert 0.7 <= best <= 1.0
    assert cost(best) <= min(cost(best * other) for other in (0.97, 0.99, 1.01, 1.03)) + 1e-6


def test_raised_targets_give_the_true_contrast():
    """Draws as scattered as the photograph's windows are nearest to them at their own size."""
    generator = torch.Generator().manual_seed(4)
    draws = (0.5 * torch.randn(400, 40, 40, generator=generator)).exp()
    first, second = torch.arange(0, 200), torch.arange(200, 400)
    raised = draws[second] / _best_scale(draws[first], draws[second])
    assert _best_scale(draws[first], draws[second]) < 0.9
    assert _best_scale(draws[first], raised) == pytest.approx(1.0, abs=0.01)


def test_a_picture_without_neighbours_is_left_as_it_is():
    linear, encoding, windows = cut(width=32, height=32)
    here = describe(linear[None], encoding, BANK)
    assert float(distance(windows.target, here, Weights())) < 1e-5


@pytest.mark.parametrize(("width", "height"), [(96, 64), (97, 33), (32, 32), (200, 40)])
def test_windows_cover_the_picture_and_stay_inside(width, height):
    _, _, windows = cut(width=width, height=height)
    seen = torch.zeros(height, width, dtype=torch.bool)
    for x, y in corners(windows, width, height):
        assert 0 <= x <= width - SIZE and 0 <= y <= height - SIZE
        seen[y : y + SIZE, x : x + SIZE] = True
    assert bool(seen.all()) and len(set(corners(windows, width, height))) == windows.count


def test_windows_hardly_seen_are_left_out():
    valid = torch.ones(HIGH, WIDE, dtype=torch.bool)
    valid[:, 48:] = False
    _, _, windows = cut(valid)
    assert 0 < windows.count < cut()[2].count
    for x, y in corners(windows):
        assert valid[y : y + SIZE, x : x + SIZE].float().mean() >= 0.3


def test_without_valid_texels_all_windows_are_kept():
    _, _, windows = cut(torch.zeros(HIGH, WIDE, dtype=torch.bool))
    assert windows.count == cut()[2].count


# Noise is no texture: renderings get it before they are compared with a noisy photograph.


NOISE_BANK = FilterBank(FilterBankConfig(sizes=(3,), filters=8, levels=3))
SEEN = torch.ones(photograph().shape[1:], dtype=torch.bool)


def draw(linear, seed, strength=0.1):
    """Shot noise."""
    generator = torch.Generator().manual_seed(seed)
    return strength * linear.sqrt() * torch.randn(linear.shape, generator=generator)


def test_the_truth_is_nearest_with_its_noise():
    clean = photograph()
    noisy = clean + draw(clean, 1)
    encoding = fit_encoding(noisy, SEEN)
    windows = cut_windows(Plane(noisy, SEEN, draw(clean, 2), encoding), NOISE_BANK, WINDOW)
    places = [(x, y) for y in (0, 16) for x in (0, 24, 48)]
    rendered = torch.stack([clean[:, y : y + WINDOW, x : x + WINDOW] for x, y in places])
    assert windows.noise.shape == rendered.shape

    def apart(pictures):
        found = describe(pictures, encoding, NOISE_BANK)
        return float(distance(found, windows.target, Weights()).mean())

    assert apart(with_noise(rendered, windows.noise, 3)) < 0.75 * apart(rendered)


def test_noise_alone_is_not_amplified():
    """Grey texture with coloured noise: without knowing better, colour is scaled up."""
    clean = photograph().mean(dim=0, keepdim=True).expand(3, -1, -1)
    noisy = clean + draw(clean, 1, 0.2)
    both = (fit_encoding(noisy, SEEN, noise) for noise in (None, draw(clean, 2, 0.2)))
    colour, grey = torch.tensor([1.0, -1.0, 0.0]), torch.ones(3)
    gains = (((e.matrix @ colour).norm(), (e.matrix @ grey).norm()) for e in both)
    amplified = [float(of_colour / of_grey) for of_colour, of_grey in gains]
    assert amplified[1] < 0.6 * amplified[0]


def test_zero_noise_changes_nothing_and_pure_noise_stays_finite():
    linear = photograph()
    plain = fit_encoding(linear, SEEN)
    none = fit_encoding(linear, SEEN, torch.zeros_like(linear))
    torch.testing.assert_close(plain.matrix, none.matrix)
    flat = torch.full_like(linear, 0.3)
    only = fit_encoding(flat + draw(flat, 1, 0.05), SEEN, draw(flat, 2, 0.08))
    assert bool(torch.isfinite(only.matrix).all())


def test_noise_is_permuted_and_scaled_with_the_light():
    rendered = photograph()[None, :, :WINDOW, :WINDOW]
    share = torch.randn(rendered.shape, generator=torch.Generator().manual_seed(0))
    first, second = (with_noise(rendered, share, step) for step in (1, 2))
    assert not torch.equal(first, second) and torch.equal(first, with_noise(rendered, share, 1))
    added = (first - rendered) / shot_deviation(rendered)
    sizes = [noise.abs().flatten(2).sort().values for noise in (added, share)]
    torch.testing.assert_close(*sizes, atol=1e-4, rtol=1e-4)


def test_noise_is_rectified_like_the_picture():
    setup = a_setup(tilt=(0.15, -0.1))
    photo = uniform(setup)
    assert read_plane(photo, setup, 96).noise is None
    both = replace(photo, noise=photo.pixels - 0.01)
    linear, valid = rectify(both, setup, 96)
    noise = read_plane(both, setup, 96).noise
    torch.testing.assert_close(noise[:, valid], linear[:, valid] - 0.01, atol=1e-5, rtol=0.0)


def test_tuning_takes_the_noise_and_stays_the_same_every_time():
    seen = scene()
    noise = torch.randn(seen.windows.points.shape, generator=torch.Generator().manual_seed(0))
    noisy = replace(seen, windows=replace(seen.windows, noise=0.05 * noise))
    first, again, without = (tune(steps=4, seen=one).history for one in (noisy, noisy, seen))
    assert [one[2] for one in first] == [one[2] for one in again]
    assert [one[2] for one in first] != [one[2] for one in without]
