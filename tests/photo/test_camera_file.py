"""Profiles of cameras as files, and the names that photographs give their cameras."""

import json

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from matcap.capture.pipeline import read_photograph
from matcap.capture.settings import CaptureSettings
from matcap.errors import UsageError
from matcap.photo.camera import CameraProfile, Falloff, read_camera_profile, write_camera_profile
from matcap.photo.exif import read_exif
from matcap.photo.load import load_photo

PROFILE = CameraProfile("matcap phone, 4.25 mm", Falloff((0.4, 0.9), (0.1, 0.12), -0.5), 12)


@pytest.fixture
def file(tmp_path):
    write_camera_profile(tmp_path / "camera.json", PROFILE)
    return tmp_path / "camera.json"


def test_a_profile_is_read_as_it_was_written(file):
    assert read_camera_profile(file) == PROFILE
    before = file.read_bytes()
    write_camera_profile(file, read_camera_profile(file))
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda document: "{", "this is not a camera profile"),
        (lambda document: "[]", "it is none"),
        (lambda document: json.dumps({**document, "format": "matcap report"}), "it is none"),
        (lambda document: json.dumps({**document, "version": 9}), "version is 9, not 1"),
        (lambda document: json.dumps({**document, "falloff": [0.1]}), "falloff is not two numbers"),
        (lambda document: json.dumps({**document, "falloff": [0.1, 1e9]}), "falloff"),
        (lambda document: json.dumps({**document, "deviation": [0.1, 0.0]}), "deviation"),
        (lambda document: json.dumps({**document, "deviation": [0.1, "x"]}), "deviation"),
        (lambda document: json.dumps({**document, "correlation": 1.0}), "correlation"),
        (lambda document: json.dumps({**document, "photographs": 0}), "photographs"),
        (
            lambda document: json.dumps({k: v for k, v in document.items() if k != "camera"}),
            "'camera' is",
        ),
        (lambda document: " " * 200_000, "too large"),
    ],
)
def test_a_bad_profile_is_refused_in_one_sentence(file, change, said):
    file.write_text(change(json.loads(file.read_text())))
    with pytest.raises(UsageError, match="matcap batch wrote") as refused:
        read_camera_profile(file)
    assert said in str(refused.value) and str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_profile_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        read_camera_profile(tmp_path / "none.json")


def picture(path, maker="", model="", lens="", zoom=None):
    exif = Image.Exif()
    exif.update({number: text for number, text in ((271, maker), (272, model)) if text})
    own = {0x920A: IFDRational(4.25), 0xA434: lens}
    own |= {} if zoom is None else {0xA404: IFDRational(zoom)}
    exif.get_ifd(0x8769).update(own)
    Image.effect_noise((160, 120), 60).convert("RGB").save(path, exif=exif)
    return path


def test_a_photograph_names_its_camera_with_lens_length_and_zoom(tmp_path):
    whole = picture(tmp_path / "a.jpg", "Maker", "Phone 3", "back lens", 2.0)
    assert read_exif(whole).camera == "Maker Phone 3 back lens, 4.25 mm, zoom 2"
    assert load_photo(whole).camera == read_exif(whole).camera
    twice = picture(tmp_path / "b.jpg", "Maker", "Maker Phone 3", zoom=1.0)
    assert read_exif(twice).camera == "Maker Phone 3, 4.25 mm"
    assert read_exif(picture(tmp_path / "c.jpg", "Maker")).camera == ""


def test_captures_read_photographs_with_the_profile_that_is_given(tmp_path, file):
    settings = CaptureSettings.of({"camera": str(file), "preset": "instant"})
    own = read_photograph(picture(tmp_path / "a.jpg", "matcap", "phone"), settings)
    assert own.profile == PROFILE
    assert not any("profile" in note for note in own.notes)
    other = read_photograph(picture(tmp_path / "b.jpg", "Maker", "Phone 3"), settings)
    assert other.profile == PROFILE
    assert any(
        "of matcap phone, 4.25 mm, the photograph of Maker Phone 3" in n for n in other.notes
    )
    assert CaptureSettings.of(settings.named()) == settings
    assert "camera" not in CaptureSettings().named()
