"""Captures and inspections take the alignment branch's angles as a measurement, and say so."""

import json
import math
from dataclasses import replace

import pytest
from simulated.files import write_jpeg
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, as_photo, hold, take, take_several

from matcap.capture import tilt
from matcap.capture.inspection import inspect_file
from matcap.capture.outputs import OutputSettings
from matcap.capture.pipeline import capture_into
from matcap.capture.settings import CaptureSettings
from matcap.capture.tilt import fit_photograph, tilt_document
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.space.alignment import TiltMeasurement

TILTED = tuple(
    (name, (0.2 * math.cos(angle), 0.2 * math.sin(angle)))
    for angle, name in enumerate(("leather", "granite", "rust", "plaster", "cloth", "tile"))
)
SAID = TiltMeasurement(math.radians(9.0), math.radians(-6.0), 1e-4, 1e-4)


def tilted_photo(name, tilt):
    """A material, its camera tilted by radians."""
    phone = PhoneCamera(width=320, height=240, supersampling=1)
    setup = FlashSetup(offset=(0.03, 0.12, 0.0), tilt=tilt)
    return as_photo(take(piece(name), phone, setup), 1, name)


@pytest.fixture
def asked(monkeypatch):
    """A branch that is certain of 9 and -6 degrees, and the photographs it was asked of."""
    names = []

    def measure(photo):
        names.append(photo.name)
        return SAID

    monkeypatch.setattr(tilt, "tilt_measurement", measure)
    return names


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Two photographs of one piece."""
    folder = tmp_path_factory.mktemp("photographs")
    phone = PhoneCamera(width=480, height=360, supersampling=1)
    hand = Hand()
    shots = take_several(piece("tile"), phone, hold(phone, hand, 2, 3), hand, 3)
    for index, held in enumerate(shots):
        write_jpeg(folder / f"tile_{index}.jpg", held, index)
    return sorted(folder.glob("tile_*.jpg"))


@pytest.mark.parametrize("generator", ["example", "decoder"])
def test_a_capture_uses_the_tilt_of_the_alignment_branch(tmp_path, photos, asked, generator):
    steps = 1 if generator == "decoder" else None
    settings = CaptureSettings(preset="draft", steps=steps, detail=160, generator=generator)
    capture_into(tmp_path / "out", photos[:1], settings, OutputSettings((32, 32)))
    assert asked == [photos[0].name]
    camera = json.loads((tmp_path / "out" / "report.json").read_text())["camera"]
    values = camera["tilt_sources"]
    assert values["branch"] == [9.0, -6.0]
    assert values["used"] == pytest.approx([9.0, -6.0], abs=0.3)
    assert camera["tilt_degrees"] == pytest.approx(values["used"], abs=0.01)
    assert max(abs(p - b) for p, b in zip(values["picture"], values["branch"], strict=True)) > 1.0


def test_an_inspection_asks_the_branch(photos, asked):
    seen = inspect_file(photos[0], 320)
    assert asked == [photos[0].name]
    assert seen.tilt is not None and seen.tilt["branch"] == [9.0, -6.0]
    value = seen.quality["tilt"].value
    assert (value["up"], value["right"]) == pytest.approx((9.0, 6.0), abs=0.4)


def test_the_real_branch_brings_fits_nearer_to_the_truth():
    """As RAW. With a sign turned, or the branch not asked, fits are no nearer."""
    alone, measured = [], []
    for name, truth in TILTED:
        photo = tilted_photo(name, truth)
        for fit, errors in ((fit_coarse(photo), alone), (fit_photograph(photo), measured)):
            errors += [abs(a - b) for a, b in zip(fit.setup.tilt, truth, strict=True)]
    assert sum(measured) < sum(alone)


def test_without_a_measurement_nothing_is_told(photos):
    photo = tilted_photo(*TILTED[0])
    assert tilt_document(fit_coarse(photo)) is None
    assert fit_photograph(replace(photo, flash_intensity=3.0)).setup.intensity == (3.0,) * 3
