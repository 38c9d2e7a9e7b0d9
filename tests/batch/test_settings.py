"""matcap.toml and flags; what a material is made from."""

import pytest

from matcap.batch import identity as identities
from matcap.batch.identity import identity
from matcap.batch.settings import BatchSettings, settings_of
from matcap.capture.settings import CaptureSettings, Statistics
from matcap.errors import UsageError


def test_flags_win_over_the_file_and_the_file_over_defaults(tmp_path):
    (tmp_path / "matcap.toml").write_text(
        'preset = "draft"\ndetail = 512\nsize = "256x128"\ntime = "2m"\npng = true\nfov = 60\n'
    )
    settings = settings_of(tmp_path, {"detail": 256, "preset": None, "png": False})
    capture, outputs = settings.capture, settings.outputs
    assert (capture.preset, capture.detail, outputs.png) == ("draft", 256, False)
    assert (outputs.size, capture.time_limit, capture.fov) == ((256, 128), 120.0, 60.0)
    assert capture.seed == outputs.seed == CaptureSettings().seed


def test_settings_by_name_and_back():
    named = BatchSettings().named() | CHANGES | {"jobs": 2}
    settings = BatchSettings.of(named)
    assert settings.named() == named
    assert settings.capture.seed == settings.outputs.seed == 3
    assert settings.capture.time_limit == 5.0 and settings.outputs.targets == ("gltf",)


def test_the_file_in_the_folder_wins_over_its_parents(tmp_path):
    (tmp_path / "shoot").mkdir()
    (tmp_path / "matcap.toml").write_text("detail = 512\n")
    assert settings_of(tmp_path / "shoot", {}).capture.detail == 512
    (tmp_path / "shoot/matcap.toml").write_text("detail = 256\n")
    assert settings_of(tmp_path / "shoot", {}).capture.detail == 256


def test_a_prior_is_relative_to_the_file(tmp_path):
    (tmp_path / "matcap.toml").write_text('prior = "mine.safetensors"\n')
    assert settings_of(tmp_path, {}).capture.prior == str(tmp_path / "mine.safetensors")
    (tmp_path / "matcap.toml").write_text('prior = "none"\n')
    assert settings_of(tmp_path, {}).capture.prior == "none"


def test_weights_are_relative_to_the_file(tmp_path):
    (tmp_path / "matcap.toml").write_text('statistics = "vgg19=mine.pth"\n')
    assert settings_of(tmp_path, {}).capture.statistics == Statistics(
        "vgg19", tmp_path / "mine.pth"
    )


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("prest = 'draft'", "'preset'"),
        ("Detail = 512", "'detail'"),
        ("preset = 'drafd'", "'draft'"),
        ("group = 'folder'", "none, name, dir, time"),
        ("detail = '512'", "a whole number"),
        ("detail = true", "a whole number"),
        ("detail = 10", "between 64 and 8192"),
        ("fov = nan", "between 1 and 170"),
        ("size = '12y'", "4096x256"),
        ("size = [1, 2, 3]", "4096x256"),
        ("time = 'soon'", "90s"),
        ("statistics = 'vgg'", "vgg19=FILE"),
        ("tile = true\nsize = 100", "multiples of 16"),
        ("preset = {a = 1}", "a text"),
        ("seed = ", "not TOML"),
        ("a = " + "[" * 20000, "not TOML"),
    ],
)
def test_a_wrong_setting_is_named_with_the_nearest_known_one(tmp_path, text, word):
    (tmp_path / "matcap.toml").write_text(text)
    with pytest.raises(UsageError) as raised:
        settings_of(tmp_path, {})
    assert word in str(raised.value) and len(str(raised.value)) < 400
    assert raised.value.exit_code == 2


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "matcap.toml").write_bytes(b"preset = '\xff\xfe'")
    with pytest.raises(UsageError, match="not TOML"):
        settings_of(tmp_path, {})


CHANGES = {
    "preset": "draft", "steps": 7, "time": 5.0, "detail": 77, "fov": 30.0, "seed": 3,
    "size": (64, 32), "tile": True, "png": True, "normal": "dx",
    "export": ("gltf",), "statistics": "vgg19=weights.pth", "generator": "decoder", "aligned": True,
    "width_cm": 20.0, "drawing": False,
}  # fmt: skip


def test_every_setting_that_matters_changes_the_identity(tmp_path):
    photo = tmp_path / "a.jpg"
    photo.write_bytes(b"light")
    base = BatchSettings()
    first = identity([photo], base, prior="p")
    for name, value in CHANGES.items():
        assert identity([photo], BatchSettings.of({name: value}), prior="p") != first, name
    rest = set(base.named()) - set(CHANGES)
    assert rest == {"jobs", "group", "gap", "card", "prior"}
    assert identity([photo], BatchSettings(jobs=3), prior="p") == first


def test_photograph_prior_card_and_version_change_the_identity(tmp_path, monkeypatch):
    photo, base = tmp_path / "a.jpg", BatchSettings()
    photo.write_bytes(b"light")
    first = identity([photo], base, prior="p")
    assert identity([photo], base, prior="q") != first
    assert identity([photo], base, prior="p", card="c") != first
    assert identity([photo, photo], base, prior="p") != first
    photo.rename(tmp_path / "b.jpg")
    assert identity([tmp_path / "b.jpg"], base, prior="p") == first
    with monkeypatch.context() as patch:
        patch.setattr(identities, "MAKER_VERSION", "0")
        assert identity([tmp_path / "b.jpg"], base, prior="p") != first
    (tmp_path / "b.jpg").write_bytes(b"other light")
    assert identity([tmp_path / "b.jpg"], base, prior="p") != first
