"""A batch finds the profiles of its cameras, saves them, and takes them again when it goes on."""

import json
from dataclasses import replace

import pytest
from simulated.files import write_jpeg
from simulated.materials import piece
from simulated.photographs import PhoneCamera, take
from test_run import FakeWorkers, Watcher

from matcap.batch import cameras, whole
from matcap.batch.cameras import camera_of
from matcap.batch.entries import Policy
from matcap.batch.settings import BatchSettings
from matcap.batch.whole import prepare, work_off
from matcap.capture import tilt
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap.photo.camera import read_camera_profile, write_camera_profile

NAMES = ("leather", "granite", "rust", "plaster", "cloth", "tile")
LOST = (0.6, 1.0)
SETTINGS = BatchSettings.of({"detail": 512, "size": (64, 64)})


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    camera = PhoneCamera(width=160, height=120, supersampling=1)
    setup = FlashSetup(offset=(0.1, 0.05, 0.0), vignetting=LOST[0], vignetting_quartic=LOST[1])
    for seed, name in enumerate(NAMES):
        write_jpeg(folder / f"{name}.jpg", take(piece(name, seed), camera, setup), seed)
    return folder


@pytest.fixture(scope="module")
def fits():
    return {}


@pytest.fixture(autouse=True)
def fitted_once(fits, monkeypatch):
    """Coarse fits are true ones, and of each picture made once: they take a second."""
    fit_photograph = tilt.fit_photograph

    def once(photo):
        key = hash(photo.pixels.tobytes())
        fits[key] = fits.get(key) or fit_photograph(photo)
        return fits[key]

    monkeypatch.setattr(tilt, "fit_photograph", once)


@pytest.fixture
def shoot(pictures, tmp_path):
    folder = tmp_path / "shoot"
    folder.mkdir()
    for file in pictures.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.fixture
def batch(shoot, tmp_path, monkeypatch):
    """Run a batch with a workers that does what it is told; the jobs and what was said."""

    def go(settings=SETTINGS, policy=None):
        workers, watcher, policy = FakeWorkers(lambda job: True), Watcher(), policy or Policy()
        monkeypatch.setattr(whole, "Processes", lambda size, work, settle: workers)
        monkeypatch.setattr(whole, "write_index", lambda out, entries: None)
        assert (
            work_off(prepare(shoot, tmp_path / "out", settings, policy, watcher), policy, watcher)
            == 0
        )
        return workers.jobs, watcher.notes

    return go


def test_a_shoot_tells_the_falloff_of_its_camera_which_is_saved_and_taken_again(
    batch, shoot, tmp_path, monkeypatch
):
    jobs, notes = batch()
    file = tmp_path / "out/camera.json"
    found = read_camera_profile(file)
    assert {job.profile for job in jobs} == {found} and len(jobs) == len(NAMES)
    assert found.photographs == len(NAMES) and found.camera.startswith("matcap simulated phone")
    assert sum(found.falloff.mean) == pytest.approx(sum(LOST), abs=0.4)
    assert found.says() in notes
    # Nothing is estimated again, and nothing made; what comes later has the same profile.
    before = file.read_bytes()
    monkeypatch.setattr(cameras, "estimated_profile", lambda *args: pytest.fail("estimated"))
    assert batch()[0] == [] and file.read_bytes() == before
    (shoot / "again.jpg").write_bytes((shoot / "rust.jpg").read_bytes())
    (job,) = batch()[0]
    assert (job.name, job.profile) == ("again", found)


def test_a_batch_begun_anew_finds_the_same_bytes(batch, tmp_path):
    batch()
    file = tmp_path / "out/camera.json"
    before = file.read_bytes()
    file.unlink()
    assert batch()[0] == [] and file.read_bytes() == before
    # Another profile makes other materials.
    write_camera_profile(file, replace(read_camera_profile(file), photographs=99))
    assert len(batch()[0]) == len(NAMES)


def test_few_photographs_and_a_given_profile_leave_a_batch_without_its_own(batch, shoot, tmp_path):
    for name in NAMES[:2]:
        (shoot / f"{name}.jpg").unlink()
    assert {job.profile for job in batch()[0]} == {None}
    assert not (tmp_path / "out/camera.json").exists()
    (shoot / "more").mkdir()  # other pictures of it are the same camera's
    for number in range(2):
        (shoot / f"more/{number}.jpg").write_bytes((shoot / "rust.jpg").read_bytes())
    assert len({job.profile for job in batch()[0]} - {None}) == 1
    given = tmp_path / "mine.json"
    mine = replace(read_camera_profile(tmp_path / "out/camera.json"), photographs=99)
    write_camera_profile(given, mine)
    settings = BatchSettings.of({**SETTINGS.named(), "camera": str(given)})
    jobs = batch(settings)[0]
    assert len(jobs) == 6 and {job.profile for job in jobs} == {None}
    assert batch(settings)[0] == []
    write_camera_profile(given, replace(mine, photographs=98))
    assert len(batch(settings)[0]) == 6


def test_pictures_without_exif_are_one_camera_s_by_size_and_folder(shoot):
    from PIL import Image

    names = set()
    for folder in ("day1", "day2"):
        (shoot / folder).mkdir()
        for number, size in enumerate(((160, 120), (120, 160))):
            path = shoot / folder / f"{number}.png"
            Image.new("RGB", size).save(path)
            names.add(camera_of(path, shoot))
    assert sorted(name.rpartition(" in ")[2] for name in names) == ["day1", "day2"]
    assert all("without Exif" in name for name in names)


def test_a_damaged_profile_in_the_output_ends_the_batch_in_a_sentence(batch, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/camera.json").write_text("{}")
    with pytest.raises(UsageError, match=r"camera\.json: this is not a camera profile"):
        batch()


def test_the_command_writes_the_profile_of_a_folder(shoot, tmp_path, capsys):
    out = tmp_path / "mine.json"
    assert main(["camera", str(shoot), "-o", str(out)]) == 0
    assert read_camera_profile(out).photographs == len(NAMES)
    assert "its corners get" in capsys.readouterr().err
    assert main(["inspect", str(shoot / "rust.jpg"), "--camera", str(out), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)["photographs"][0]
    assert values["profile"]["photographs"] == len(NAMES)
    for name in NAMES[:2]:
        (shoot / f"{name}.jpg").unlink()
    assert main(["camera", str(shoot), "-o", str(out)]) == 3
    assert "give five or more" in capsys.readouterr().err
