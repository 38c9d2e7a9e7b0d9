"""Captures judged by floors, on a tiny photograph, and the command that does so."""

from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.lab.bench.relit import relight_all
from matcap.lab.floors.distance import Measure
from matcap.lab.floors.run import FloorSettings, Judge, MapNumbers
from matcap.lab.floors.squeezenet import SqueezeNet
from matcap.lab.floors.subjects import USUAL, subjects
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import photograph
from matcap.photo.load import load_photo

SMALL = FloorSettings(detail=256, size=128, camera=PhoneCamera(160, 120))


@pytest.fixture(scope="module")
def measure():
    torch.manual_seed(0)
    return Measure(SqueezeNet())


def test_subjects_by_name_kind_and_folder():
    assert [s.name for s in subjects(())] == list(USUAL)
    first, second = subjects(["weave", "weave:7"])
    texel = 2.0 / 256
    assert first.pieces(0)(32, 32, texel).height.shape == (1, 32, 32)
    assert not torch.equal(
        first.pieces(0)(32, 32, texel).height, second.pieces(0)(32, 32, texel).height
    )
    with pytest.raises(UsageError, match="no such material"):
        subjects(["cheese"])


def test_exposure_is_the_camera_s_times_the_stops(tmp_path):
    (subject,) = subjects(["plaster"])
    path, plain = photograph(subject, SMALL.camera, tmp_path)
    assert path.suffix == ".dng"
    path, darker = photograph(subject, SMALL.camera, tmp_path, stops=-1.0, jpeg=True)
    assert path.suffix == ".jpg" and load_photo(path).original_size == (160, 120)
    assert darker.linear.mean() == pytest.approx(0.5 * plain.linear.mean())
    assert darker.setup.intensity[0] == pytest.approx(0.5 * plain.setup.intensity[0])


def test_true_maps_are_nearer_than_flat_ones_in_any_detail(measure):
    (subject,) = subjects(["plaster"])
    shot = photograph_setup()
    # Maps that went through no lens are held against truths that went through none.
    sharp = replace(SMALL, camera=replace(SMALL.camera, blur=0.0))
    judge = Judge(subject, shot, sharp, measure)
    true = subject.pieces(77)(256, 256, 2.0 / 512)
    flat = replace(true, height=0.0 * true.height, roughness=0.0 * true.roughness + 0.3)
    near = judge.floors(true, shot.intensity)
    assert judge.floors(flat, shot.intensity) > 1.2 * near
    pictures = relight_all(flat.map(lambda m: m.float()), shot.intensity, judge.scene)
    assert pictures.shape[-1] == 256  # compared with pictures of 128


def test_a_true_piece_in_finer_detail_looks_as_truths_do(measure):
    (subject,) = subjects(["plaster"])
    shot = photograph_setup()
    sharp = replace(SMALL, camera=replace(SMALL.camera, blur=0.0))
    judge = Judge(subject, shot, sharp, measure)
    side, texel = sharp.finer * sharp.size, 2.0 / (sharp.finer * sharp.detail)
    true = subject.pieces(subject.seed + 1)(side, side, texel)
    torch.testing.assert_close(judge.relit(true, shot.intensity), judge.pictures[0])


def photograph_setup():
    from matcap.flash.geometry import FlashSetup

    return FlashSetup(fov=65.0, intensity=(2.0, 2.0, 2.0))


def test_numbers_tell_tilt_albedo_and_roughness():
    ramp = 0.1 * torch.arange(16.0).expand(1, 16, 16)
    albedo = torch.full((3, 16, 16), 0.5)
    maps = MapSet(albedo, ramp * 0.0, ramp * 0.0 + 0.4, ramp, texel_size=0.1)
    told = MapNumbers.of(maps)
    assert told.tilt == pytest.approx(45.0, abs=0.01)
    assert (told.albedo, told.roughness) == (pytest.approx(0.0, abs=1e-5), pytest.approx(0.4))
