"""Which places of an exemplar a field shows: none that depart by a trend, none twice in sight."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from exemplars import an_example, exemplar

from matcap.capture.exemplar.estimate import indexed
from matcap.example.candidates import Frame, choose_scale, features_of, grids_of, planes_of
from matcap.example.example import Example
from matcap.example.index import PENALTY_BITS, _stains, prepare
from matcap.example.placement import (
    RULE,
    PatchNumbers,
    Placement,
    _trend,
    evenly_sharp,
    reuse_cost,
    spread_patches,
    trend_penalty,
)
from matcap.field.plane import Rectangle

SIDES = 512, 384
WINDOW = 48


def waves(random, width, height, along):
    """Noise of wavelengths of 8 to 16 texels, of waves within 30 degrees of an axis."""
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)
    angle = np.arctan2(np.abs(fy), np.abs(fx) + 1e-9)
    off = angle if along == "x" else np.pi / 2 - angle
    octave = np.log2(np.maximum(np.hypot(fx, fy), 1e-9) * 11.0)
    share = (np.abs(octave) < 0.5) * (off < np.pi / 6)
    noise = np.fft.ifft2(np.fft.fft2(random.standard_normal((height, width))) * share).real
    return noise / noise.std()


def combed(width=SIDES[0], height=SIDES[1], seed=3):
    """Relief of which only waves towards the middle are known, as under one flash."""
    random = np.random.default_rng(seed)
    across, down = (waves(random, width, height, along) for along in "xy")
    y, x = np.mgrid[0:height, 0:width]
    angle = np.arctan2(y - height / 2, x - width / 2)
    relief = np.cos(angle) ** 2 * across + np.sin(angle) ** 2 * down
    flat = np.zeros_like(relief)
    return exemplar(np.stack([flat, flat, flat, relief]))


def even(width=SIDES[0], height=SIDES[1], seed=4):
    """Relief of all waves everywhere."""
    random = np.random.default_rng(seed)
    relief = sum(waves(random, width, height, along) for along in "xy")
    flat = np.zeros_like(relief)
    return exemplar(np.stack([flat, flat, flat, relief]))


def squares(piece):
    return tuple(-(-side // 4) for side in piece.size[::-1])


def unevenness(heights, texel_size):
    """Standard deviation over windows of log contrast, lit from the left and from the top."""
    down, right = np.gradient(heights / texel_size)
    logs = []
    for slope in (right, down):
        shaded = np.log(np.maximum(0.5 - 0.86 * slope, 0.05))
        rows, columns = (side // WINDOW * WINDOW for side in shaded.shape)
        cut = shaded[:rows, :columns].reshape(rows // WINDOW, WINDOW, -1, WINDOW)
        logs.append(np.log(cut.std(axis=(1, 3))).std())
    return np.array(logs)


def field_of(example, seed=1):
    return example.maps(seed, Rectangle(0, 0, 768, 576), None)[-1]


def test_relief_with_a_trend_of_direction_makes_no_quilt():
    piece = combed()
    made = Example.of(piece)
    without = replace(made, index=replace(made.index, penalty=0 * made.index.penalty))
    before, after = (unevenness(field_of(e), piece.texel_size) for e in (without, made))
    assert (after < 0.75 * before).all()


def test_material_without_a_trend_has_no_penalty():
    piece = even()
    assert trend_penalty(planes_of(piece), np.ones(squares(piece), bool)).max() == 0.0


def test_contrast_of_albedo_without_relief_may_have_a_trend():
    piece = even()
    noise = np.random.default_rng(8).standard_normal(piece.height.shape).astype(np.float32)
    rising = np.linspace(0.05, 0.4, SIDES[0], dtype=np.float32)
    albedo = (0.2 * np.exp(rising * cv2.GaussianBlur(noise[0], (0, 0), 2.0) * 7.0)).clip(0.0, 1.0)
    drawn = replace(piece, diffuse=np.broadcast_to(albedo, piece.diffuse.shape).copy())
    known = np.ones(squares(piece), bool)
    flat = replace(drawn, height=0.0 * piece.height)
    assert trend_penalty(planes_of(flat), known).max() == 0.0


def spread_of_contrast(albedo):
    """Standard deviation over windows of the log contrast of albedo's finest octave."""
    log = np.log(albedo.mean(axis=0))
    fine = log - cv2.GaussianBlur(log, (0, 0), 1.0)
    rows, columns = (side // WINDOW for side in fine.shape)
    fine = fine[: rows * WINDOW, : columns * WINDOW]
    return np.log(fine.reshape(rows, WINDOW, columns, WINDOW).std(axis=(1, 3))).std()


def drawn(texture):
    albedo = 0.2 * np.exp(texture.clip(-1.5, 1.5)).astype(np.float32)
    return replace(even(), diffuse=np.broadcast_to(albedo, (3, *albedo.shape)).copy())


def test_corners_that_a_lens_blurs_are_as_sharp_as_the_middle():
    noise = np.random.default_rng(9).standard_normal(SIDES[::-1]).astype(np.float32)
    sharp = 0.6 * cv2.GaussianBlur(noise, (0, 0), 0.8)
    soft = cv2.GaussianBlur(sharp, (0, 0), 0.8)
    y, x = np.mgrid[-1 : 1 : SIDES[1] * 1j, -1 : 1 : SIDES[0] * 1j]
    share = 0.5 * (x**2 + y**2)
    piece = drawn(sharp + share * (soft - sharp))
    exemplar, example = indexed(piece.rounded(), (), turned=False)
    made = example.exemplar
    assert spread_of_contrast(made.diffuse) < 0.6 * spread_of_contrast(exemplar.diffuse)
    assert made.diffuse.std() == pytest.approx(exemplar.diffuse.std(), rel=0.1)
    assert (made.specular == exemplar.specular).all() and (made.height == exemplar.height).all()


def test_a_material_whose_contrast_rises_is_not_sharpened():
    noise = np.random.default_rng(9).standard_normal(SIDES[::-1]).astype(np.float32)
    texture = np.linspace(0.2, 0.8, SIDES[0]) * cv2.GaussianBlur(noise, (0, 0), 0.8)
    piece = drawn(texture)
    before, after = (spread_of_contrast(e.diffuse) for e in (piece, evenly_sharp(piece)))
    assert before > 0.3 and after == pytest.approx(before, rel=0.05)


def test_creases_in_a_few_places_are_no_trend():
    """A polynomial has much of their variance, but predicts none of it from the squares around."""
    piece = even()
    random, (y, x) = np.random.default_rng(5), np.mgrid[0 : SIDES[1], 0 : SIDES[0]]
    steep = np.zeros((SIDES[1], SIDES[0]))
    for at_x, at_y in ((70, 60), (150, 300), (300, 130), (440, 330)):
        steep += 6.0 * np.exp(-0.5 * ((x - at_x) ** 2 + (y - at_y) ** 2) / 45.0**2)
    relief = piece.height[0] * (1.0 + steep * waves(random, *SIDES, "x").clip(0.0))
    creased = replace(piece, height=relief[None].astype(np.float32))
    known = np.ones(squares(piece), bool)
    assert (trend_penalty(planes_of(creased), known) > 0.0).mean() < 0.1
    assert (trend_penalty(planes_of(combed()), known) > 0.0).mean() > 0.3


def stains_of(piece):
    planes = planes_of(piece)
    levels = grids_of(features_of(planes, choose_scale(planes)), 5)
    return _stains(levels, np.ones(squares(piece), bool))


@pytest.mark.parametrize("size", [40, 64, 96])
def test_stains_that_fit_into_a_patch_are_left_out_with_nothing_around(size):
    random, (y, x) = np.random.default_rng(4), np.mgrid[0 : SIDES[1], 0 : SIDES[0]]
    tone = 0.3 * cv2.GaussianBlur(random.standard_normal(x.shape), (0, 0), 1.0)
    off = np.hypot(x - 250, y - 180)
    stained, long = tone - 1.2 * (off < size / 2), tone - 1.2 * (np.abs(y - x + 60) < 20)
    none, stain, vein = (stains_of(drawn(texture)) for texture in (tone, stained, long))
    step = SIDES[0] // stain.shape[1]
    inside, outside = (
        where[step // 2 :: step, step // 2 :: step]
        for where in (off < size / 2 - 8, off > size / 2 + 24)
    )
    assert none.mean() < 0.01 and vein.mean() < 0.02
    assert stain[inside].mean() > 0.9 and stain[outside].mean() < 0.02


def test_a_trend_that_predicts_little_of_the_rest_costs_nothing():
    noise = np.random.default_rng(6).standard_normal((1, 48, 64))
    across = np.linspace(-1.0, 1.0, 64)
    faint, strong = (
        _trend(noise + share * across, np.ones((48, 64), bool), 1.0) for share in (0.45, 3.0)
    )
    assert np.ptp(faint) == 0.0 and np.ptp(strong) > 4.0


def test_a_side_with_marks_of_its_own_is_shown_as_often():
    # The left has scratches, which is no trend that exceeds what the rest of the variation does.
    piece = even()
    random = np.random.default_rng(7)
    albedo = piece.diffuse.copy()
    marks = np.stack([random.integers(8, s - 8, 60) for s in SIDES], axis=1)
    for x, y in marks[marks[:, 0] < SIDES[0] // 2]:
        albedo[:, y - 2 : y + 3, x - 2 : x + 3] *= 0.5
    made = Example.of(replace(piece, diffuse=albedo))
    places = made.places(1, Rectangle(0, 0, 1024, 1024), None)
    assert 0.3 < float((places[..., 0] < SIDES[0] // 2).mean()) < 0.7


def test_no_known_place_gives_no_penalty():
    piece = even(64, 48)
    assert not trend_penalty(planes_of(piece), np.zeros(squares(piece), bool)).any()


def shared(x, y, sides):
    """Sum over neighbouring patches of the share of what both show."""
    total = 0.0
    for dy, dx in ((0, 1), (1, 0), (1, 1)):
        in_field = [at[dy:, dx:] - at[: len(at) - dy, : at.shape[1] - dx] for at in (x, y)]
        both = [
            np.maximum(side - np.abs(a), 0) / side for a, side in zip(in_field, sides, strict=True)
        ]
        total += np.prod(both, axis=0).sum()
    return total


@pytest.mark.parametrize("sides", [(128, 128), (256, 64), (64, 256)])
def test_patches_near_each_other_show_different_places(sides):
    frame = Frame(128, 128, 900, 700)
    cost = np.zeros((200, 250), np.int32)
    numbers = tuple(PatchNumbers(np.arange(1536 // side), None, side) for side in sides)
    x, y = spread_patches(Placement(cost, 3), 5, 4, frame, numbers)
    random = np.random.default_rng(1)
    other = (
        random.integers(frame.left, frame.right + 1, x.shape),
        random.integers(frame.top, frame.bottom + 1, x.shape),
    )
    assert shared(x, y, sides) < 0.3 * shared(*other, sides)


@pytest.mark.parametrize("count", [None, 5, 7, 12])
@pytest.mark.parametrize("sides", [(128, 128), (256, 64), (64, 256)])
def test_a_patch_is_the_same_whatever_else_is_laid(sides, count):
    frame = Frame(64, 64, 900, 700)
    cost = np.random.default_rng(2).integers(0, 1 << 20, (200, 250)).astype(np.int32)
    placement = Placement(cost, 3)

    def laid(columns, rows):
        axes = [
            PatchNumbers(np.array(n), count, side)
            for n, side in zip((columns, rows), sides, strict=True)
        ]
        return spread_patches(placement, 5, 4, frame, tuple(axes))

    many = laid(range(5), range(5))
    one = laid([3], [2])
    assert one[0][0, 0] == many[0][2, 3] and one[1][0, 0] == many[1][2, 3]


def test_reuse_costs_by_area_and_nearness_and_a_continuation_nothing():
    def cost(x, y, side, *wrap):
        shift = np.array([x]), np.array([y])
        return int(reuse_cost(shift, (side, 0), (side, side), 640, *wrap)[0])

    assert cost(0, 0, 100) > cost(50, 0, 100) > cost(0, 100, 100) == 0 and cost(100, 0, 100) == 0
    # Patches of a whole exemplar of 800 texels: the end of one begins the other.
    assert cost(600, 0, 800, (800, 800)) > 0 and cost(0, 0, 800, (800, 800)) == 0


def test_means_of_costs_are_those_of_what_a_patch_shows():
    cost = np.random.default_rng(3).integers(0, 1000, (40, 50)).astype(np.int32)
    placement = Placement.of(cost, 2, (32, 16), None)
    y, x = 20, 30
    assert placement.cost[y, x] == pytest.approx(cost[18:22, 26:34].mean(), abs=2)
    joined = Placement.of(cost, 2, (32, 16), Frame(0, 0, 199, 159))
    around = np.take(np.take(cost, range(-2, 2), 0, mode="wrap"), range(-4, 4), 1, mode="wrap")
    assert joined.cost[0, 0] == pytest.approx(around.mean(), abs=2)
    assert (Placement.of(cost, 1, (32, 16), None).cost == cost).all()


def test_marks_and_trends_cost_corrections_less_than_placement():
    made = Example.of(even())
    penalty = made.index.penalty.copy()
    penalty[:4, :6] = (0, 14, 60, 220, 254, 255)
    index = replace(made.index, penalty=penalty)
    lookup = prepare(made.exemplar, index, 0.5)
    assert (lookup.cost >> PENALTY_BITS)[0, :6].tolist() == [p * p for p in penalty[0, :6].tolist()]
    corrected = [lookup.levels[-1].placement_cost[0, k] >> PENALTY_BITS for k in range(6)]
    assert corrected == [0, 10**2, 10**2, 209**2, 40**2, 255**2]
    by_3 = prepare(made.exemplar, replace(index, rule=3), 0.5).levels[-1].placement_cost
    assert [by_3[0, k] >> PENALTY_BITS for k in range(3)] == [0, 14**2, 20**2]
    earlier = lookup.of_rule_2(), prepare(made.exemplar, replace(index, rule=2), 0.5)
    assert [one.rule for one in earlier] == [2, 2]
    for one in (*earlier, prepare(made.exemplar, index)):  # small patches have nothing to keep
        assert all((level.placement_cost == lookup.cost).all() for level in one.levels)
        assert {level.similar_shift for level in one.levels} == {1}


def test_corrections_do_not_collapse_onto_the_places_of_least_penalty():
    # Three quarters have the largest penalty of a trend.
    made = Example.of(even())
    penalty = np.where(np.indices(made.index.penalty.shape)[1] < 32, 0, 60).astype(np.uint8)
    shown = []
    for rule in (2, RULE):
        index = replace(made.index, penalty=penalty, rule=rule)
        example = replace(made, index=index, variety=0.25)
        places = example.places(1, Rectangle(0, 0, *SIDES), None) // 8
        shown.append(len(np.unique(places.reshape(-1, 2), axis=0)))
    assert shown[1] > 2 * shown[0]


def test_a_file_without_a_placement_rule_has_rule_1():
    example = an_example()
    tensors, about = example.stored()
    assert about["index"]["placement"] == example.index.rule == RULE
    about = json.loads(json.dumps(about))
    del about["index"]["placement"]
    old = Example.read(about, tensors.__getitem__)
    assert old.lookup.rule == old.index.rule == 1 and "placement" not in old.stored()[1]["index"]
    about["index"]["placement"] = RULE + 1
    with pytest.raises(ValueError, match=f"rule {RULE + 1}"):
        Example.read(about, tensors.__getitem__)
