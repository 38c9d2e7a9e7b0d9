"""White balance and colours of DNGs, as Adobe's specification has them."""

import struct

import numpy as np
import pytest
from simulated.files import XYZ_TO_REC709, color_matrix, mosaic, rationals, write_dng

from matcap.photo.dng_color import dng_color, temperature
from matcap.photo.load import load_photo

D65, A = (0.3127, 0.3290), (0.44758, 0.40745)
NEUTRAL = np.array([0.5, 1.0, 0.7])
GREY = np.full((96, 128, 3), 0.4)
MIXING = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])
OTHER = np.array([[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]])
# What a DNG says that LibRaw alone would overlook.
WHITE_XY = (50729, 5, 2, rationals(D65), True)
SENSITIVE = np.diag(NEUTRAL) @ color_matrix(np.eye(3))  # of a camera that sees white as NEUTRAL


def xyz(white):
    x, y = white
    return np.array([x / y, 1.0, (1 - x - y) / y])


def tags(matrix, **more):
    """As tifffile hands them over: `color2`, `kelvin` and so on by name."""
    number = {
        "color2": 50722, "own1": 50723, "own2": 50724, "balance": 50727, "neutral": 50728,
        "white": 50729, "forward1": 50964, "forward2": 50965,
    }  # fmt: skip
    stated = {50721: rationals(np.ravel(matrix)), 50778: more.pop("kind1", 21)}
    if "kind2" in more:
        stated[50779] = more.pop("kind2")
    return stated | {number[name]: rationals(np.ravel(value)) for name, value in more.items()}


@pytest.mark.parametrize(
    ("more", "says"),
    [((WHITE_XY,), "white point (0.3127, 0.3290)"), ((), "daylight (D65) assumed")],
    ids=["white", "nothing"],
)
def test_a_dng_without_a_neutral_is_balanced_by_its_matrix(tmp_path, more, says):
    """Grey of any picture stays grey, and a brown one brown: no grey world."""
    for light in (GREY, GREY * [1.5, 1.0, 0.5]):
        path = write_dng(
            tmp_path / "a.dng", mosaic(light * NEUTRAL), neutral=None, color_matrix=SENSITIVE,
            more=more,
        )  # fmt: skip
        photo = load_photo(path)
        np.testing.assert_allclose(photo.pixels.mean((0, 1)), light[0, 0], atol=2e-3)
        assert [says in note for note in photo.notes] == [True]
        np.testing.assert_allclose(photo.balance, NEUTRAL.max() / NEUTRAL, rtol=1e-3)


def test_a_neutral_goes_before_a_white_point(tmp_path):
    path = write_dng(
        tmp_path / "a.dng", mosaic(GREY * NEUTRAL), neutral=tuple(NEUTRAL), more=[WHITE_XY]
    )
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels.mean((0, 1)), 0.4, atol=1e-3)
    assert photo.notes == ()


def test_temperatures_of_known_whites():
    assert temperature(A) == pytest.approx(2856, abs=5)
    assert temperature(D65) == pytest.approx(6504, abs=5)


def test_matrices_are_mixed_by_the_inverse_temperature():
    """At 2850 K the first illuminant's, at 6500 K the second's, half of each between in 1 / T."""
    first, second = color_matrix(MIXING), color_matrix(OTHER)
    middle = 2.0 / (1.0 / 2850.0 + 1.0 / 6500.0)
    x = next(x for x in np.linspace(0.30, 0.45, 4001)[::-1] if temperature((x, 0.38)) >= middle)
    for white, mixed in [
        (A, first),
        (D65, second),
        ((float(x), 0.38), (first + second) / 2),
    ]:
        found = dng_color(tags(first, color2=second, kind1=17, kind2=21, white=white))
        expected = mixed @ xyz(white)
        np.testing.assert_allclose(found.neutral, expected / expected.max(), rtol=2e-3)
        # The same white told as its camera colours gives the same colours.
        same = dng_color(tags(first, color2=second, kind1=17, kind2=21, neutral=found.neutral))
        np.testing.assert_allclose(same.matrix, found.matrix, atol=2e-3)


def test_one_illuminant_that_is_not_known_leaves_the_first_matrix():
    alone = dng_color(tags(color_matrix(MIXING), white=D65))
    for kind in (0, 21):
        both = tags(color_matrix(MIXING), color2=color_matrix(OTHER), kind2=kind, white=D65)
        np.testing.assert_array_equal(dng_color(both).matrix, alone.matrix)


def test_calibration_and_analog_balance_are_the_camera_s_own():
    own, gains = np.diag([0.8, 1.0, 1.3]), np.array([1.2, 1.0, 0.9])
    stated = tags(color_matrix(MIXING), own1=own, balance=gains, white=D65)
    expected = np.diag(gains) @ own @ color_matrix(MIXING) @ xyz(D65)
    np.testing.assert_allclose(dng_color(stated).neutral, expected / expected.max(), rtol=1e-5)
    stated[50931] = "another calibration"  # which the profile's matrices are not for
    expected = np.diag(gains) @ color_matrix(MIXING) @ xyz(D65)
    np.testing.assert_allclose(dng_color(stated).neutral, expected / expected.max(), rtol=1e-5)


def test_a_forward_matrix_says_the_colours(tmp_path):
    """It goes to XYZ relative to D50; here of a camera that mixes like OTHER once balanced."""
    rec709 = np.zeros((96, 128, 3))
    rec709[:, :64], rec709[:, 64:] = (0.5, 0.2, 0.1), (0.1, 0.3, 0.6)
    balanced = OTHER / OTHER.sum(axis=1, keepdims=True)
    to_d50 = [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169],
              [0.0139322, 0.0971045, 0.7141733]]  # fmt: skip
    forward = np.array(to_d50) @ np.linalg.inv(balanced)
    photo = load_photo(
        write_dng(
            tmp_path / "a.dng",
            mosaic(rec709 @ balanced.T * NEUTRAL),
            neutral=tuple(NEUTRAL),
            more=[(50964, 10, 9, rationals(np.ravel(forward)), True)],
        )
    )
    inner = np.r_[4:60, 68:124]
    np.testing.assert_allclose(photo.pixels[4:-4, inner], rec709[4:-4, inner], atol=2e-3)


@pytest.mark.parametrize("white", [(0.0, 0.0), (0.99, 0.3), (0.3, -0.1)])
def test_a_white_that_is_none_is_not_followed(white):
    assert "daylight" in dng_color(tags(XYZ_TO_REC709, white=white)).note


def test_a_camera_that_nobody_knows_is_told_of(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(GREY * NEUTRAL), neutral=tuple(NEUTRAL))
    assert load_photo(path).notes == ()
    entry, none = (struct.pack("<HHI", tag, 10, 9) for tag in (50721, 50720))
    path.write_bytes(path.read_bytes().replace(entry, none))
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels.mean((0, 1)), 0.4, atol=1e-3)
    assert "no colour matrix" in photo.notes[0]


def test_without_a_colour_matrix_there_is_nothing_to_work_out():
    assert dng_color({50728: rationals(NEUTRAL)}) is None
    with pytest.raises(ValueError, match="basis|white|singular|Singular"):
        dng_color(tags(np.ones((3, 3)), white=D65))
