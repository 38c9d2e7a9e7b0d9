"""Inspection of a photograph, and the calibration card."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from arrays import photo_from_array
from PIL import Image
from simulated.files import write_jpeg, write_shot
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take

from matcap.brdf.maps import MapSet
from matcap.capture.inspection import _darker, photograph_quality
from matcap.cli.main import main
from matcap.errors import MatcapError
from matcap.files.color import srgb_decode, srgb_encode
from matcap.flash.coarse.fit import CoarseFit, fit_coarse, rescale_to_flash
from matcap.flash.geometry import FlashSetup
from matcap.photo.calibrate import PATCHES, calibrated, card_sentence, fit_patches, read_card
from matcap.photo.checks import Rating
from matcap.photo.inspect import hot_spot, inspect_photo, softness
from matcap.photo.load import load_photo

# What inspect says of simulated photographs, whose truth is known.


CAMERA = PhoneCamera(width=320, height=240, supersampling=1)
SETUPS = [
    FlashSetup(offset=(0.12, 0.05, 0.0), tilt=(0.03, -0.02)),
    FlashSetup(offset=(-0.1, 0.08, 0.0), tilt=(-0.12, 0.1)),
    FlashSetup(offset=(0.02, -0.12, 0.0), tilt=(0.0, -0.17)),
]
NAMES = ["leather", "cloth", "granite", "rust"]


def flat(roughness: float, albedo: float = 0.25, f0: float = 0.04):
    """A uniform material: what the hot spot would be without texture."""

    def realise(width, height, texel):
        one = torch.ones(1, height, width, dtype=torch.float64)
        return MapSet(albedo * one.expand(3, -1, -1), f0 * one, roughness * one, 0.0 * one, texel)

    return realise


@pytest.fixture(scope="module")
def shots():
    return {
        (name, index): take(piece(name, 7 + index), CAMERA, setup)
        for name in NAMES
        for index, setup in enumerate(SETUPS)
    }


def test_the_hot_spot_is_within_two_percent_of_the_width(shots):
    """Of where a uniform material of the same roughness is brightest under the same flash."""
    errors = []
    for (name, index), shot in shots.items():
        maps = piece(name, 7 + index)(64, 64, 2.0 / 320)
        ideal = take(flat(float(maps.roughness.mean())), CAMERA, SETUPS[index]).linear.mean(-1)
        row, column = np.unravel_index(ideal.argmax(), ideal.shape)
        (x, y), _ = hot_spot(as_photo(shot, 1, name))
        errors.append(math.hypot(x * 320 - column - 0.5, y * 240 - row - 0.5) / 320)
    assert np.mean(errors) < 0.02


@pytest.mark.parametrize("gain", [0.7, 1.3, 1.6])
def test_the_clipped_share_is_within_one_percent(shots, tmp_path, gain):
    """Whatever it is shrunk to, and whether or not a mosaic was developed."""
    errors = []
    for name in ("leather", "granite", "rust"):
        shot = shots[name, 0]
        shot = replace(shot, linear=shot.linear * gain)
        truth = float((shot.linear >= 1.0).any(-1).mean())
        write_jpeg(tmp_path / "a.jpg", shot, 1)
        write_shot(tmp_path / "a.dng", shot, 1)
        for file in ("a.jpg", "a.dng"):
            photo = load_photo(tmp_path / file, long_side=128)
            errors.append(inspect_photo(photo)["clipped"].value - truth)
    assert np.abs(errors).mean() < 0.01


def test_the_sign_of_the_tilt_is_right(shots):
    """RAW, as captures estimate it: no farther off than half of what square to the sample is."""
    errors, square = [], []
    for name, index in (("leather", 1), ("granite", 2), ("rust", 1)):
        value = photograph_quality(as_photo(shots[name, index], 1, name))["tilt"].value
        tilt_x, tilt_y = (math.degrees(angle) for angle in SETUPS[index].tilt)
        errors += [value["up"] - tilt_x, value["right"] + tilt_y]
        square += [tilt_x, tilt_y]
    assert np.abs(errors).mean() < 0.5 * np.abs(square).mean()


def grey(texture: float = 0.1, falloff: float = 1.0) -> np.ndarray:
    """A shaded grey surface with fine grain."""
    y, x = np.mgrid[-0.75:0.75:192j, -1.0:1.0:256j]
    noise = np.random.default_rng(3).normal(0.0, texture, (192, 256, 1))
    return (0.4 / (1.0 + falloff * (x**2 + y**2)))[..., None] * np.exp(noise) * np.ones(3)


def photo_of(pixels: np.ndarray, **changes):
    return replace(photo_from_array(pixels.astype(np.float32)), **changes)


def test_a_good_photograph_is_called_good():
    found = inspect_photo(photo_of(grey(), radiometric=True, flash_fired=True), (0.01, 0.0))
    assert found.rating.fit and found["hot_spot"].value == pytest.approx([0.5, 0.5], abs=0.02)


@pytest.mark.parametrize(("stops", "says"), [(-4.5, ""), (-8.0, "of the picture is black")])
def test_even_black_gloss_is_no_screenshot(stops, says):
    """A highlight on black in a few of 255 codes; exposed still shorter, the picture is black."""
    light = 2.0**stops * take(flat(0.2, albedo=0.02), CAMERA, SETUPS[0]).linear
    codes = np.round(255.0 * srgb_encode(light.clip(0.0, 1.0).astype(np.float32))) / 255.0
    pixels = srgb_decode(codes.astype(np.float32))
    far = CAMERA.width // 32
    assert (pixels[far:] == pixels[:-far]).all(2).mean() > 0.4
    subject = inspect_photo(photo_of(pixels))["subject"]
    assert subject.rating is (Rating.FAILED if says else Rating.GOOD) and says in subject.says


def test_a_flat_grey_is_not_called_sharp():
    result = inspect_photo(photo_from_array(np.full((64, 64, 3), 0.2, np.float32)))["sharpness"]
    assert result.value is None and result.rating is Rating.NOT_JUDGED
    assert "Sharpness cannot be measured" in result.says


@pytest.mark.parametrize(
    ("tilt", "turned", "side"),
    [
        ((0.15, 0.0), False, "upper side"),
        ((-0.15, 0.0), False, "lower side"),
        ((0.0, 0.15), False, "left side"),
        ((0.1, -0.1), False, "upper right side"),
        # Turned a quarter anticlockwise: its top is the upright picture's right.
        ((0.15, 0.0), True, "right side"),
        ((0.0, 0.15), True, "upper side"),
    ],
)
def test_the_tilt_is_in_directions_of_the_upright_picture(tilt, turned, side):
    finding = inspect_photo(photo_of(grey(), turned=turned), tilt)["tilt"]
    assert finding.rating is not Rating.GOOD and side in finding.says and side in finding.remedy


def test_the_hot_spot_of_a_portrait_is_in_upright_coordinates(tmp_path):
    """The same picture lying and standing: the file's own left top is what is told."""
    pixels = np.roll(grey(0.02), 50, axis=1).clip(0, 1)  # towards the right
    cv2.imwrite(str(tmp_path / "lying.png"), (pixels * 255).astype(np.uint8))
    standing = np.rot90(pixels, -1)  # clockwise: the right is now at the bottom
    cv2.imwrite(str(tmp_path / "standing.png"), (standing * 255).astype(np.uint8))
    lying = inspect_photo(load_photo(tmp_path / "lying.png"))["hot_spot"].value
    stood = inspect_photo(load_photo(tmp_path / "standing.png"))["hot_spot"].value
    assert stood == pytest.approx([1.0 - lying[1], lying[0]], abs=0.01) and stood[1] > 0.6


def test_every_fault_has_a_remedy():
    burnt = photo_of(np.minimum(grey() * 3.0, 1.0))
    cases = {
        "clipped": (burnt, "lower the exposure"),
        "flash": (photo_of(grey(), flash_fired=False), "flash switched on"),
        "sharpness": (photo_of(cv2.GaussianBlur(grey(), (0, 0), 4.0)), "focus"),
        "hot_spot": (photo_of(np.roll(grey(), 120, axis=1)[:, :128]), "in the picture"),
    }
    for name, (photo, word) in cases.items():
        finding = inspect_photo(photo)[name]
        assert finding.rating in (Rating.DOUBTFUL, Rating.FAILED), name
        assert word in finding.remedy
    even = inspect_photo(photo_of(grey(falloff=0.0), flash_fired=True))["flash"]
    assert not even.rating.fit


@pytest.mark.parametrize("blur", [1.0, 2.0, 3.0])
def test_softness_estimates_the_blur_in_pixels(blur):
    """Of a picture whose gradients are equally strong at all sizes: white noise, integrated."""
    rng = np.random.default_rng(0)
    frequency = np.hypot(*np.meshgrid(np.fft.rfftfreq(512), np.fft.fftfreq(512)))
    frequency[0, 0] = np.inf
    pattern = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(512, 512))) / frequency)
    picture = np.exp(0.1 * cv2.GaussianBlur(pattern / pattern.std(), (0, 0), blur))
    found = softness(np.repeat(picture[..., None], 3, axis=2).astype(np.float32))
    assert found == pytest.approx(blur, rel=0.25)


def test_two_materials_in_one_picture_are_not_uniform(shots):
    one, other = (as_photo(shots[name, 0], 1, name) for name in ("leather", "cloth"))
    mixed = one.pixels.copy()
    mixed[:, 160:] = other.pixels[:, 160:] * one.pixels.mean() / other.pixels.mean()
    whole, half = (inspect_photo(p)["stationarity"] for p in (one, replace(one, pixels=mixed)))
    assert whole.rating is Rating.GOOD and half.rating in (Rating.DOUBTFUL, Rating.FAILED)
    assert half.value > 2.0 * whole.value


def test_the_darkest_channel_of_a_saturated_jpeg_makes_no_parts():
    """Green of a deep blue is cut off at zero in places of no meaning."""
    light = grey(0.03, falloff=3.0)
    patches = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(192, 256, 1)), (0, 0), 16.0)
    green = np.maximum(0.003 * patches / patches.std(), 0.0)[..., None]
    blue = light * np.concatenate([np.full_like(green, 0.02), green, np.full_like(green, 0.3)], 2)
    found = inspect_photo(photo_of(blue))
    assert found["subject"].rating is Rating.GOOD and found["stationarity"].rating is Rating.GOOD


def test_the_command_prints_json_and_goes_on_after_a_bad_file(shots, tmp_path, capsys):
    write_shot(tmp_path / "a.dng", shots["leather", 0], 1, shading=0.4)
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8\xff nothing")
    code = main(["inspect", str(tmp_path / "a.dng"), str(tmp_path / "b.jpg"), "--json"])
    good, bad = json.loads(capsys.readouterr().out)["photographs"]
    assert code == 4 and good["radiometric"]["value"] is True
    assert "the flash fired" in good["flash"]["message"]
    assert abs(good["tilt"]["value"]["degrees"]) < 8
    assert "truncated or damaged" in bad["reason"]
    assert main(["inspect", str(tmp_path / "b.jpg")]) == 3


def test_notes_of_reading_are_findings():
    plain = inspect_photo(photo_of(grey(), flash_fired=True))
    assert "reading" not in plain.document()
    notes = ("The file carries an HDR gain map, which was not applied.", "Daylight assumed.")
    found = inspect_photo(replace(photo_of(grey(), flash_fired=True), notes=notes))
    assert (found["reading"].value, found["reading"].rating) == ([*notes], Rating.NOT_JUDGED)
    assert "switch HDR off" in found["reading"].remedy and found.rating is plain.rating


def test_an_assumed_field_of_view_is_a_finding(tmp_path, codes):
    Image.fromarray(codes).save(tmp_path / "a.png")
    assert "66 degrees assumed" in inspect_photo(load_photo(tmp_path / "a.png"))["reading"].says
    assert "reading" not in inspect_photo(load_photo(tmp_path / "a.png", fov=60.0)).document()


def test_details_are_printed_on_request(shots, tmp_path, capsys):
    write_jpeg(tmp_path / "a.jpg", shots["granite", 0], 1)
    assert main(["inspect", str(tmp_path), "--details"]) == 0
    details = capsys.readouterr().out
    assert len(details.splitlines()) > 8 and "square to the sample" in details
    assert details.count("albedo is relative") == 1


def test_a_folder_prints_a_line_per_photograph(shots, tmp_path, capsys):
    write_jpeg(tmp_path / "a.jpg", shots["granite", 0], 1)
    Image.fromarray(np.full((300, 400, 3), 90, np.uint8)).save(tmp_path / "plain.png")
    assert main(["inspect", str(tmp_path)]) == 0
    first, second, *shared = capsys.readouterr().out.splitlines()
    assert "a.jpg: " in first
    assert second.startswith("!  plain.png: failed: The picture is one plain colour")
    assert shared and all(line.startswith("   all: ") for line in shared)


# The calibration card of examples/card.pdf: photographed (simulated), and read back.


UNIT = 170.0  # millimetres: half of what the photograph's long side shows
CARD_CAMERA = PhoneCamera(width=1024, height=768, supersampling=1, clipped=0.0)
TILT = (0.06, -0.08)


def raster(pixels_per_mm):
    """(H, W, 3) uint8 sRGB picture of the page that users print."""
    page = (Path(__file__).parents[2] / "examples/card.pdf").read_text("latin-1")
    scale = pixels_per_mm * 25.4 / 72.0  # pixels a point
    _, _, across, up = map(float, re.search(r"MediaBox \[(.*?)\]", page).group(1).split())
    picture = np.full((round(up * scale), round(across * scale), 3), 255, np.uint8)
    for line in re.findall(r"^(.* rg .*) re f$", page, re.MULTILINE):
        *colour, x, y, width, height = (float(word) for word in line.replace("rg", "").split())
        left, right = (round(value * scale) for value in (x, x + width))
        top, bottom = (round((up - value) * scale) for value in (y + height, y))
        picture[top:bottom, left:right] = np.round(np.array(colour) * 255.0)
    return picture


def card_maps(width, height, texel):
    """The page lying on a grey table, its long side along x."""
    page = srgb_decode(np.rot90(raster(4.0)) / 255.0)
    albedo = np.full((height, width, 3), 0.3)
    row, column = (
        ((np.arange(side) + 0.5 - side / 2) * texel * UNIT * 4 + pixels / 2).astype(int)
        for side, pixels in ((height, page.shape[0]), (width, page.shape[1]))
    )
    inside = [(at >= 0) & (at < side) for at, side in zip((row, column), page.shape, strict=False)]
    albedo[np.ix_(*inside)] = page[np.ix_(row[inside[0]], column[inside[1]])]
    one = torch.ones(1, height, width, dtype=torch.float64)
    return MapSet(torch.from_numpy(albedo).permute(2, 0, 1), 0.01 * one, 0.9 * one, 0 * one, texel)


@pytest.fixture(scope="module")
def shot():
    return take(card_maps, CARD_CAMERA, FlashSetup(offset=(0.08, 0.05, 0.0), tilt=TILT))


@pytest.fixture(scope="module")
def calibration(shot, tmp_path_factory):
    path = tmp_path_factory.mktemp("card") / "card.dng"
    write_shot(path, shot, 1)
    return read_card(path)


def test_the_board_gives_scale_and_tilt(calibration):
    assert calibration.millimetres_per_unit == pytest.approx(UNIT, rel=0.005)
    true = math.degrees(math.acos(math.cos(TILT[0]) * math.cos(TILT[1])))
    assert calibration.tilt == pytest.approx(true, abs=0.5)


def test_the_patches_give_the_flash_intensity(shot, calibration):
    found = math.pi * shot.setup.distance**2 * calibration.white
    assert found == pytest.approx(shot.setup.intensity[0], rel=0.04)
    # The DNG's own matrix is right already.
    np.testing.assert_allclose(calibration.matrix, np.eye(3), atol=0.06)
    assert calibration.residual < 0.04


def test_a_jpeg_gives_scale_and_no_colours(shot, tmp_path):
    write_jpeg(tmp_path / "card.jpg", shot, 1)
    found = read_card(tmp_path / "card.jpg")
    assert found.millimetres_per_unit == pytest.approx(UNIT, rel=0.005)
    assert found.matrix is None and "albedo is relative" in card_sentence(found)
    assert "albedo is relative" in card_sentence(None)


def test_albedo_becomes_absolute(calibration, tmp_path):
    """A grey card of known albedo, whose brightness alone cannot tell it from a dim flash."""
    camera = replace(CARD_CAMERA, width=128, height=96, brightness=0.4)
    shot = take(flat(0.7, 0.09, 0.03), camera, FlashSetup(offset=(0.08, 0.05, 0.0)))
    path = tmp_path / "grey.dng"
    # The same flash and exposure as the card's photograph, whatever the brightness comes to.
    gain = math.pi * shot.setup.distance**2 * calibration.white / shot.setup.intensity[0]
    write_shot(path, replace(shot, linear=shot.linear * gain), 1)
    photo = load_photo(path)
    known = calibrated(photo, calibration)
    assert known.flash_intensity is not None and photo.flash_intensity is None
    untold = fit_coarse(known)
    coarse = rescale_to_flash(untold, known.flash_intensity)
    assert np.mean(coarse.diffuse) == pytest.approx(0.09, rel=0.15)
    assert rescale_to_flash(untold, None) is untold
    assert calibrated(replace(photo, radiometric=False), calibration).flash_intensity is None


def test_colour_matrix_and_falloff_are_fitted_together():
    rng = np.random.default_rng(0)
    true = srgb_decode(np.array(PATCHES) / 255.0)
    response = 0.5 * np.array([[0.8, 0.2, 0.0], [0.1, 0.9, 0.05], [0.0, 0.3, 0.7]])
    places = rng.uniform(-0.6, 0.6, (24, 2))
    falloff = np.exp(0.2 * places[:, 0] - 0.7 * (places**2).sum(axis=1))
    fit = fit_patches(falloff[:, None] * (true @ response.T), places)
    assert fit.residual < 1e-3
    np.testing.assert_allclose(fit.matrix @ response / fit.white, np.eye(3), atol=1e-2)
    # Colours in another order are no ColorChecker.
    assert fit_patches(true[rng.permutation(24)], places).residual > 0.2


def test_a_photograph_without_a_card_is_refused(tmp_path):

    shot = take(piece("granite", 3), PhoneCamera(width=256, height=192), FlashSetup())
    write_jpeg(tmp_path / "card.jpg", shot, 1)
    with pytest.raises(MatcapError, match="no card is seen"):
        read_card(tmp_path / "card.jpg")


# Advice for a clipped highlight: how many stops darker another exposure is to be.


def fit(intensity: float, roughness: float = 0.2) -> CoarseFit:
    setup = FlashSetup(fov=66.0).with_intensity((intensity,) * 3)
    return CoarseFit((0.2, 0.2, 0.2), 0.04, roughness, setup, residual=0.1)


def stops(advice: str) -> int:
    return int(advice.split(" stops")[0].rsplit(" ", 1)[1])


@pytest.mark.parametrize("merged", [False, True])
def test_the_brighter_the_highlight_the_darker_the_exposure(merged):
    intensities = (0.01, 0.3, 1.0, 4.0, 1000.0)
    advised = [stops(_darker(fit(intensity), 1.0, merged)) for intensity in intensities]
    assert advised == sorted(advised) and len(set(advised)) >= 3
    assert (advised[0], advised[-1]) == (2, 6)
    assert stops(_darker(fit(4.0), 4.0, merged)) == stops(_darker(fit(1.0), 1.0, merged))


@pytest.mark.parametrize("roughness", [0.1, 0.5])
@pytest.mark.parametrize("merged", [False, True])
def test_the_advice_names_the_position(roughness, merged):
    assert "from the same place" in _darker(fit(1.0, roughness), 1.0, merged)
