"""The calibration card of examples/card.pdf: photographed (simulated), and read back."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from simulated.files import write_jpeg, write_shot
from simulated.materials import piece
from simulated.photographs import PhoneCamera, take

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.srgb import srgb_decode
from matcap.flash.coarse.fit import fit_coarse, rescale_to_flash
from matcap.flash.geometry import FlashSetup
from matcap.photo.calibrate import PATCHES, calibrated, card_sentence, fit_patches, read_card
from matcap.photo.load import load_photo

UNIT = 170.0  # millimetres: half of what the photograph's long side shows
CAMERA = PhoneCamera(width=1024, height=768, supersampling=1, clipped=0.0)
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
    column = ((np.arange(width) + 0.5 - width / 2) * texel * UNIT * 4 + page.shape[1] / 2).astype(
        int
    )
    row = ((np.arange(height) + 0.5 - height / 2) * texel * UNIT * 4 + page.shape[0] / 2).astype(
        int
    )
    inside = np.ix_((row >= 0) & (row < page.shape[0]), (column >= 0) & (column < page.shape[1]))
    albedo[inside] = page[row.clip(0, page.shape[0] - 1)][:, column.clip(0, page.shape[1] - 1)][
        inside
    ]
    one = torch.ones(1, height, width, dtype=torch.float64)
    return MapSet(torch.from_numpy(albedo).permute(2, 0, 1), 0.01 * one, 0.9 * one, 0 * one, texel)


@pytest.fixture(scope="module")
def shot():
    return take(card_maps, CAMERA, FlashSetup(offset=(0.08, 0.05, 0.0), tilt=TILT))


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
    distance = shot.setup.distance
    found = math.pi * distance**2 * calibration.white
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

    def grey(width, height, texel):
        one = torch.ones(1, height, width, dtype=torch.float64)
        return MapSet(0.09 * one.expand(3, -1, -1), 0.03 * one, 0.7 * one, 0 * one, texel)

    camera = replace(CAMERA, width=128, height=96, brightness=0.4)
    shot = take(grey, camera, FlashSetup(offset=(0.08, 0.05, 0.0)))
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
