"""Maps against relit true samples, and what is photographed for that."""

import statistics
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError, UsageError
from matcap.flash.geometry import FlashSetup
from matcap.photo.load import load_photo
from matcap_lab.bench.floors import photo_as_albedo
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator, map_statistics, relight_all
from matcap_lab.measures.nsd import SqueezeNet, SqueezeNetStyle
from matcap_lab.measures.style import RandomFilters, difference
from matcap_lab.simulate.photograph import PhoneCamera, as_photo
from matcap_lab.simulate.specimen import EXAMPLES, USUAL, phone_cone, photograph, subjects

SMALL = EvaluationSettings(detail=256, size=128, camera=PhoneCamera(160, 120))
FLASH = FlashSetup(fov=65.0, intensity=(2.0, 2.0, 2.0))
PLASTER = EXAMPLES["plaster"]


@pytest.fixture(scope="module")
def styles():
    torch.manual_seed(0)
    return {"NSD": SqueezeNetStyle(SqueezeNet())}


@pytest.fixture(scope="module")
def sharp(styles):
    """Maps that went through no lens are held against truths that went through none."""
    settings = replace(SMALL, camera=replace(SMALL.camera, blur=0.0))
    return Evaluator(PLASTER, FLASH, settings, styles)


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


def test_exposure_is_the_camera_s_and_its_offset(tmp_path):
    path, plain = photograph(PLASTER, SMALL.camera, tmp_path)
    assert path.suffix == ".dng"
    path, darker = photograph(PLASTER, SMALL.camera, tmp_path, ev=-1.0)
    assert darker.linear.mean() == pytest.approx(0.5 * plain.linear.mean())
    assert darker.setup.intensity[0] == pytest.approx(0.5 * plain.setup.intensity[0])


def test_a_phone_s_jpeg_is_lit_by_a_cone_beside_the_lens_s_axis(tmp_path):
    specimens = subjects(["plaster", "leather", "granite", "tile", "cloth", "rust"])
    path, shot = photograph(specimens[0], SMALL.camera, tmp_path, jpeg=True)
    assert path.suffix == ".jpg" and load_photo(path).original_size == (160, 120)
    cones = [phone_cone(one.setup, one.name) for one in specimens]
    assert shot.setup.vignetting_centre == cones[0].vignetting_centre
    lost = [cone.vignetting + cone.vignetting_quartic for cone in cones]
    assert min(lost) > 0.5 and max(lost) < 2.5
    assert statistics.mean(cone.vignetting_centre[1] for cone in cones) == pytest.approx(
        0.19, abs=0.15
    )
    assert len({cone.vignetting_centre for cone in cones}) == len(cones)


def test_true_maps_are_nearer_than_flat_ones_in_any_detail(sharp):
    true = PLASTER.pieces(77)(256, 256, 2.0 / 512)
    flat = replace(true, height=0.0 * true.height, roughness=0.0 * true.roughness + 0.3)
    near = sharp.style_ratio_of(true, FLASH.intensity)
    assert sharp.style_ratio_of(flat, FLASH.intensity) > 1.2 * near
    pictures = relight_all(flat.map(lambda m: m.float()), FLASH.intensity, sharp.scene)
    assert pictures.shape[-1] == 256  # compared with pictures of 128


def test_a_true_piece_in_finer_detail_looks_as_truths_do(sharp):
    side, texel = SMALL.finer * SMALL.size, 2.0 / (SMALL.finer * SMALL.detail)
    true = PLASTER.pieces(PLASTER.seed + 1)(side, side, texel)
    torch.testing.assert_close(sharp.relit(true, FLASH.intensity), sharp.pictures[0])


def test_an_evaluation_stays_what_was_measured_by():
    """By the code of 2026-11-25: a sharp sample in the photograph's detail, and it flat."""
    evaluator = Evaluator(PLASTER, FLASH, SMALL, {"NSD": SqueezeNetStyle()})
    true = PLASTER.pieces(77)(256, 256, 2.0 / 512)
    assert evaluator.style_ratio_of(true, FLASH.intensity) == pytest.approx(2.7971, rel=1e-3)
    flat = replace(true, height=0.0 * true.height)
    assert evaluator.style_ratio_of(flat, FLASH.intensity) == pytest.approx(3.0210, rel=1e-3)


def test_the_photograph_s_own_light_is_a_scene_of_its_own(sharp):
    (light,) = sharp.own_scene.lights
    assert light.place == (0.0, 0.0, sharp.flash.distance) and light.strength == 1.0
    found = sharp.relit_truths(sharp.own_scene)[0]
    assert sharp.style_ratio(found, scene=sharp.own_scene) < 1.0  # one of the true samples


def test_maps_that_are_smaller_than_what_is_compared_are_refused(sharp):
    with pytest.raises(MatcapError, match="128 x 128 are compared"):
        sharp.middle(PLASTER.pieces(1)(100, 200, 2.0 / 256))


def test_numbers_tell_tilt_albedo_and_roughness():
    ramp = 0.1 * torch.arange(16.0).expand(1, 16, 16)
    albedo = torch.full((3, 16, 16), 0.5)
    maps = MapSet(albedo, ramp * 0.0, ramp * 0.0 + 0.4, ramp, texel_size=0.1)
    expected = {"tilt": 45.0, "albedo": 0.0, "roughness": 0.4}
    assert map_statistics(maps) == pytest.approx(expected, abs=1e-3)


# The evaluator by random filters: another true piece is 1, and what differs is more.

# Small and coarse, for speed: what is tested is order, not figures.
CAMERA = PhoneCamera(width=512, height=384, supersampling=1)
SETTINGS = EvaluationSettings(512, 192, CAMERA, finer=2, every=1)


@pytest.fixture(scope="module")
def style():
    return RandomFilters()


@pytest.fixture(scope="module")
def shot():
    return EXAMPLES["leather"].take(CAMERA)


@pytest.fixture(scope="module")
def evaluator(style, shot):
    return Evaluator(EXAMPLES["leather"], shot.setup, SETTINGS, {"one": style})


def _pictures(evaluator, shot, material="leather"):
    """Another true piece, seen as the evaluator's."""
    size, blur = SETTINGS.size, CAMERA.blur * 2 * SETTINGS.detail / CAMERA.width
    maps = EXAMPLES[material].pieces(55)(2 * size, 2 * size, 1.0 / SETTINGS.detail)
    return relight_all(maps, shot.setup.intensity, evaluator.scene, size=(size, size), blur=blur)


@pytest.fixture(scope="module")
def truth(evaluator, shot):
    return _pictures(evaluator, shot)


def test_another_true_piece_scores_one(evaluator, truth):
    assert evaluator.style_ratio(truth) == pytest.approx(1.0, abs=0.25)


def test_blur_and_colour_are_noticed(evaluator, truth):
    right = evaluator.style_ratio(truth)
    kernel = torch.ones(3, 1, 5, 5) / 25
    blurred = F.conv2d(F.pad(truth, (2, 2, 2, 2), mode="reflect"), kernel, groups=3)
    recoloured = truth * torch.tensor([0.7, 1.0, 1.3])[:, None, None]
    darker = 0.7 * truth
    for wrong in (blurred, recoloured.clamp(0, 1), darker):
        assert evaluator.style_ratio(wrong) > 1.25 * right


def test_error_grows_towards_a_wrong_material(evaluator, truth, shot):
    wrong = _pictures(evaluator, shot, "plaster")
    errors = [
        evaluator.style_ratio(torch.lerp(truth, wrong, share)) for share in (0.0, 0.4, 0.7, 1.0)
    ]
    assert errors == sorted(errors)
    assert errors[-1] > 2.5


def test_black_pictures_compare(style):
    """A light below a bump's horizon may leave nothing; no division by zero."""
    size = SETTINGS.size
    speck = 1e-3 * torch.rand(1, 3, size, size, generator=torch.Generator().manual_seed(2))
    assert torch.isfinite(difference(style(speck), style(0.5 * speck))).all()


def test_photo_as_albedo_gives_the_photograph_back(shot):
    """Under its own flash its mean is right; that it bakes the flash in is what the bench shows."""
    photo = as_photo(shot, 1, "leather")
    maps = photo_as_albedo(photo, shot.setup, SETTINGS.detail).maps.crop(160, 96, 192, 192)
    assert maps.texel_size == 2.0 / SETTINGS.detail
    middle = torch.from_numpy(photo.pixels).permute(2, 0, 1)[:, 96:288, 160:352]
    assert float((maps.diffuse - middle).abs().mean()) < 0.05
