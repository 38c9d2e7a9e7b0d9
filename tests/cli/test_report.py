"""What the report warns of, and that it is always JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.formats import keys
from report_schema import check_report

from matcap.capture.progress import DECODER_STAGES, EXEMPLAR_STAGES, CaptureClock
from matcap.capture.report import report, warnings, write_report
from matcap.capture.result import Tuning
from matcap.capture.settings import CaptureSettings
from matcap.flash.geometry import FlashSetup
from matcap.photo.inspect import inspect_photo

STAGES = {**EXEMPLAR_STAGES, **DECODER_STAGES}


@pytest.fixture
def captured(pipeline, photo):
    """A result without anything to warn of."""
    return _captured(pipeline, photo, CaptureSettings(detail=96))


def _captured(pipeline, photo, settings):
    shown = pipeline.load_photo(photo)
    return pipeline.capture_photo(shown, settings, clock=CaptureClock(None, STAGES))


def test_a_good_capture_has_no_warnings(captured):
    assert list(warnings(captured)) == []


def test_each_warning_says_what_to_do(captured):
    def warned(tilt=(0.0, 0.0), **photographed):
        photo = replace(captured.photo, **photographed)
        seen = replace(captured.measurements, photograph=inspect_photo(photo, tilt))
        return list(warnings(replace(captured, photo=photo, measurements=seen)))

    (said,) = warned(clipped=np.ones_like(captured.photo.clipped))
    assert "100.0 % of the photograph is clipped. Lower the exposure" in said
    (said,) = warned(flash_fired=False)
    assert "did not fire" in said and "with the flash switched on" in said
    (said,) = warned(tilt=(0.0, -0.25))
    assert "tilted by 14 degrees" in said and "until it is parallel" in said


def test_its_keys_are_those_of_the_reference_and_of_the_schema(captured, tmp_path):
    write_report(captured, tmp_path / "report.json")
    check_report(tmp_path / "report.json")
    assert set(report(captured)) == keys("matcap.capture.report", "Keys")


def test_angles_are_in_degrees(captured):
    result = captured
    tilted = replace(result.material, setup=FlashSetup(tilt=(np.pi / 36, -np.pi / 18)))
    camera = report(replace(result, material=tilted))["camera"]
    assert camera["tilt_degrees"] == pytest.approx([5.0, -10.0])


def test_numbers_that_json_does_not_know_become_null(captured, tmp_path):
    went = Tuning(((0.0, 1, float("inf")), (1.0, 2, float("nan"))))
    odd = replace(captured, tuning=went)
    write_report(odd, tmp_path / "report.json")

    def refuse(name: str) -> None:
        pytest.fail(f"{name} is not JSON")

    found = json.loads(Path(tmp_path / "report.json").read_text(), parse_constant=refuse)
    assert found["tuning"]["error"] is None
    assert found["tuning"]["error_over_time"][0] == {"seconds": 0.0, "step": 1, "error": None}


def test_the_effort_is_that_of_the_settings(captured):
    effort = {"preset": "standard", "steps": 0, "detail": 96}
    assert report(captured)["effort"] == effort
    decoder = replace(captured, settings=replace(captured.settings, generator="decoder", steps=5))
    assert report(decoder)["effort"] == effort | {
        "steps": 5,
        "windows_per_step": 3,
        "matched": True,
    }


def test_a_time_limit_that_overrides_the_preset_is_noted(captured):
    usual = report(captured)["notes"]
    assert not any("preset" in note for note in usual)
    limited = replace(captured, settings=CaptureSettings(preset="draft", time_limit=9.0))
    values = report(limited)
    assert values["effort"]["detail"] == 512
    (note,) = (note for note in values["notes"] if note not in usual)
    assert "the preset has no effect: the limit determines the texels" in note
    decoder = CaptureSettings(generator="decoder", time_limit=9.0)
    (note,) = (
        note for note in report(replace(captured, settings=decoder))["notes"] if note not in usual
    )
    assert "at most 800 steps" in note
    counted = replace(captured, settings=replace(decoder, steps=5))
    assert report(counted)["notes"] == usual
