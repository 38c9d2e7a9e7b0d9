"""Maps from several photographs, and the report on them."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from report_schema import check_report
from seen_views import LOG_ERROR, OFFSET, PHONE, SIZE, flattened, grainy, photographed, seen
from simulated.photographs import Hand, hold

from matcap.capture.exemplar.estimate import estimate_exemplar
from matcap.capture.exemplar.octaves import split
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.multiview import estimate
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.multiview.set_report import (
    LeaveOneOut,
    Prediction,
    SetReport,
    draw_predicted,
    draw_set,
    left_out_residual,
    set_report_lines,
    unshaded,
)
from matcap.capture.multiview.shared import shared_step
from matcap.capture.multiview.solve import solve
from matcap.capture.multiview.surface import denoised
from matcap.capture.multiview.texels import SLOPES, Estimate, ParameterPrior, parameters_of
from matcap.capture.multiview.views import RAW_FALLOFF, SharedLight
from matcap.capture.pipeline import capture_photo
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.register import LeftOut, RegisteredView
from matcap.capture.report import warnings, write_outputs
from matcap.capture.settings import MULTIVIEW_STAGES, CaptureSettings, OutputSettings
from matcap.files.color import srgb_picture
from matcap.flash.geometry import FlashSetup
from matcap.flash.highlight import light_of
from matcap.flash.light import render_rectified
from matcap.flash.rectify import picture_of

# Several photographs of one piece: cameras, places, maps, and what is said of them.


pytestmark = pytest.mark.usefixtures("one_coarse_fit")
FEWER_PIXELS = replace(PHONE, width=480, height=360)
NOTHING_KNOWN = LOG_ERROR.expand(4, *SIZE)


def _solved(views, read, light, log_error=NOTHING_KNOWN):
    """Of RAW photographs."""
    return solve(views, Estimate(read, log_error), replace(light, vignetting_deviation=RAW_FALLOFF))


def _degrees(one, other):
    return float((one.normal * other.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg().mean())


def test_five_photographs_tell_relief_that_nothing_else_does():
    maps = grainy(0)
    views, light = seen([maps] * 5, 0.005)
    found = _solved(views, flattened(maps), light)
    assert _degrees(found.maps, maps) < 0.2 * _degrees(flattened(maps), maps)
    off = (found.maps.diffuse.log() - maps.diffuse.log()).abs().mean()
    assert off < 0.03 and max(found.residual) < 0.02 and found.measured[3] > 0.5


def test_more_photographs_tell_more():
    maps = grainy(1)
    off = []
    for count in (2, 3, 5):
        views, light = seen([maps] * count, 0.01)
        off.append(_degrees(_solved(views, flattened(maps), light).maps, maps))
    assert off[0] > 1.2 * off[1] and off[1] > 1.2 * off[2]


def shadowed(view):
    """With a third of it at a third of the light."""
    log = view.log.clone()
    log[..., : log.shape[-1] // 3] -= math.log(3.0)
    return replace(view, log=log)


def two_stops_darker(view):
    return replace(view, log=view.log - math.log(4.0))


@pytest.mark.parametrize("spoilt", [shadowed, two_stops_darker])
def test_one_photograph_that_is_spoilt_spoils_no_relief(spoilt):
    maps = grainy(4)
    views, light = seen([maps] * 5, 0.01)
    sound = _degrees(_solved(views, flattened(maps), light).maps, maps)
    views[3] = spoilt(views[3])
    assert _degrees(_solved(views, flattened(maps), light).maps, maps) < 1.3 * sound


def test_a_shadow_is_measured_and_does_not_count():
    maps = grainy(4)
    views, light = seen([maps] * 5, 0.01)
    known = Estimate(maps, NOTHING_KNOWN)
    assert unshaded(views[3], known, light)[1] < 0.01
    dark = shadowed(views[3])
    third = dark.log.shape[-1] // 3
    lit, share = unshaded(dark, known, light)
    whole = float(views[3].seen[..., :third].sum() / views[3].seen.sum())
    assert share == pytest.approx(whole, abs=0.01)
    assert lit.seen[..., :third].float().mean() < 0.05
    torch.testing.assert_close(lit.seen[..., third:], views[3].seen[..., third:])


def test_a_photograph_is_predicted_from_the_others():
    maps = grainy(2)
    views, light = seen([maps] * 5, 0.01)
    some = light.of_some([0, 1, 2, 4])
    kept = [views[k] for k in (0, 1, 2, 4)]
    found = _solved(kept, flattened(maps), some)
    error, predicted = left_out_residual(views[3], found.maps, found.light)
    assert error < 3.0 * max(found.residual)
    off = (predicted - views[3].log)[views[3].seen].abs().median()
    assert float(off) == pytest.approx(error)
    flat, _ = left_out_residual(views[3], flattened(maps), found.light)
    assert flat > 3.0 * error


@pytest.fixture(scope="module")
def five():
    """Photographs of a piece that is known, their light, and what is known."""
    maps = grainy(3)
    return *seen([maps] * 5), ParameterPrior.of(Estimate(maps, NOTHING_KNOWN))


def test_the_flash_is_found_beside_the_lens(five):
    views, light, prior = five
    begun = replace(light, offset=torch.zeros(2), vignetting_deviation=RAW_FALLOFF)
    found, _ = shared_step(views, prior.mean, prior, begun)
    assert np.abs(found.offset.numpy() - OFFSET).max() < 0.01


def test_shading_that_is_not_the_flash_s_does_not_move_it_off_the_phone(five):
    views, light, prior = five
    begun = replace(light, coarse_offset=light.offset)
    width = views[0].log.shape[-1]
    shaded = [replace(view, log=view.log + torch.linspace(-2.0, 2.0, width)) for view in views]
    for _ in range(4):
        begun, _ = shared_step(shaded, prior.mean, prior, begun)
    assert np.abs(begun.offset.numpy() - OFFSET).max() < 0.16


def test_vignetting_stays_within_its_prior_deviation(five):
    views, light, prior = five

    def off(**prior_deviation):
        lost = {"vignetting": 0.3, "vignetting_quartic": 0.0}  # the photographs lose nothing
        begun = SharedLight.of(FlashSetup(offset=(*light.offset.tolist(), 0.0), **lost), 5)
        begun = replace(begun, intensity=light.intensity, **prior_deviation)
        found, _ = shared_step(views, prior.mean, prior, begun)
        return float(found.vignetting.sum())

    assert off(vignetting_deviation=(1e-3, 1e-3)) == pytest.approx(0.3, abs=0.01)
    assert abs(off()) < 0.1


def test_gloss_that_was_read_wrong_does_not_scale_relief():
    """Nor a network that thinks itself sure of a relief half as steep."""
    maps = grainy(6)
    views, light = seen([maps] * 5, 0.005)
    read = replace(maps, roughness=maps.roughness - 0.2, height=0.5 * maps.height)
    sure = torch.log(torch.tensor([0.5, 0.05, 0.2, 0.02]))[:, None, None].expand(4, *SIZE)
    found = _solved(views, read, light, sure)
    assert found.light.gloss[0, 1] > 0.4
    before, after = (parameters_of(each)[SLOPES].square().mean() for each in (maps, found.maps))
    assert 0.75 < float(after / before) < 1.15
    assert found.prediction_error > 0.3 * float(before.sqrt())


def test_a_photograph_beside_its_place_is_brought_back_though_texels_explain_it():
    """The maps that are begun with are what the shifted photograph made of them."""
    maps = grainy(4)
    views, light = seen([maps] * 5)
    # By two texels to the right: what is looked up there lay two texels further left.
    shifted = [*views[:3], replace(views[3], log=views[3].log.roll(2, dims=2)), *views[4:]]
    flat = flattened(maps)
    found = _solved(shifted, flat, light)
    prior = ParameterPrior.of(Estimate(flat, NOTHING_KNOWN))
    numbers = parameters_of(found.maps)
    _, moves = shared_step(shifted, numbers, prior, found.light, moved=range(1, 5))
    assert moves[3][0, 2] > 0.6 * maps.texel_size
    for number in (1, 2, 4):
        assert abs(moves[number][0, 2]) < 0.7 * moves[3][0, 2]
    assert (moves[0] == np.eye(3)).all()


def test_slopes_stay_finite_where_nothing_is_seen():
    maps = grainy(5)
    views, light = seen([maps] * 3)
    blind = [replace(view, seen=torch.zeros_like(view.seen)) for view in views]
    found = solve(blind, Estimate(maps, NOTHING_KNOWN), light)
    for channel in found.maps.stacked():
        assert torch.isfinite(channel).all()
    # As it was read, but for what is slow.
    assert _degrees(found.maps, maps) < 0.4 * _degrees(flattened(maps), maps)
    torch.testing.assert_close(found.maps.diffuse, maps.diffuse, atol=0.01, rtol=0.0)
    assert torch.isfinite(found.estimate.log_error).all()


def test_photographs_of_one_piece_are_one_material(held, foreign, tmp_path):
    _, photos = held
    lines = []
    settings = CaptureSettings(preset="instant", detail=128)
    others = [photos[1], foreign, photos[2]]
    result = capture_photo(photos[0], settings, lines.append, others=others)
    stages = [name for name in MULTIVIEW_STAGES if name not in ("read", "write")]
    assert list(dict.fromkeys(now.stage for now in lines)) == stages
    assert sum(MULTIVIEW_STAGES.values()) == pytest.approx(1.0)
    fractions = [now.fraction for now in lines]
    assert fractions == sorted(fractions)
    assert any("leather_9 was left out" in warning for warning in warnings(result))
    assert result.estimate is not None and result.estimate.error < 0.1

    write_outputs(result, tmp_path / "plaster", OutputSettings((32, 32)))
    check_report(tmp_path / "plaster/report.json")
    several = json.loads((tmp_path / "plaster/report.json").read_text())["multi_view"]
    assert [one["name"] for one in several["photographs"]] == [photo.name for photo in photos]
    assert [one["name"] for one in several["left_out"]] == ["leather_9"]
    for one in several["photographs"]:
        assert 0.0 <= one["position_deviation"] < 0.01
        assert 0.0 < one["residual"] < 0.1 and math.isfinite(one["leave_one_out_residual"])
    assert all(0.0 <= share <= 1.0 for share in several["measured_share"].values())


def test_a_set_that_predicts_itself_badly_is_captured_as_its_first_photograph(held, monkeypatch):
    _, photos = held
    results, lines = [], []

    def of_one(*arguments, **options):
        results.append(estimate_exemplar(*arguments, **options))
        return results[-1]

    worse = LeaveOneOut((0.2,) * 3, (0.1,) * 3)
    monkeypatch.setattr(estimate, "leave_one_out", lambda *_arguments: worse)
    monkeypatch.setattr(estimate, "estimate_exemplar", of_one)
    settings = CaptureSettings(preset="instant", detail=128)
    found = capture_photo(photos[0], settings, lines.append, others=photos[1:]).estimate
    assert found.exemplar is results[0].exemplar
    assert found.several.document()["first_alone"]
    assert not any(found.several.measured) and found.several.basis is None
    fractions = [now.fraction for now in lines]
    assert fractions == sorted(fractions)


def highlight_contrasts(light, centre):
    """Mean light near a point of the plane over that around it: of the whole spot, of its core."""
    (high, wide), (u, v) = light.shape, centre
    y, x = np.mgrid[:high, :wide]
    distance = np.hypot((2.0 * x + 1.0 - wide) / wide - u, (high - 1.0 - 2.0 * y) / wide - v)

    def mean(inner, outer):
        return light[(distance >= inner) & (distance < outer)].mean()

    return np.array([mean(0.0, 0.15) / mean(0.4, 0.7), mean(0.0, 0.08) / mean(0.15, 0.25)])


def test_pairs_keep_the_highlight_of_glossy_tiles():
    """In the photographed rectangle: in the field it is that of the tile at the mirror point.

    On the mean of three pairs, as that of one deviates by a tenth by its place alone.
    """
    logs = []
    for seed in (5, 6, 7):
        _, (first, second) = photographed("tile", FEWER_PIXELS, 2, seed)
        settings = CaptureSettings(preset="instant", detail=192)
        captured = capture_photo(first, settings, others=[second])
        maps, setup = map_set_of(captured.estimate.first_rectangle), captured.material.setup
        with torch.inference_mode():
            rendered = picture_of(render_rectified(maps, setup))
        # Not find_highlight's contrast, which is of the brightest tile: other roundings choose
        # another.
        mirror, most = np.array(setup.offset[:2]) / 2.0, captured.photo.headroom
        before, after = (
            highlight_contrasts(np.asarray(light_of(each.clip(max=most))), mirror)
            for each in (captured.rectified, rendered)
        )
        assert before[0] > 2.0
        logs.append(np.log(after / before))
    # Roughness times 1.5 or 0.67, half of F0, twice the relief and none are outside these limits.
    spot, core = np.exp(np.mean(logs, axis=0))
    assert 0.92 < spot < 1.2 and 0.85 < core < 1.25


def test_a_pair_of_which_one_is_left_is_the_capture_of_that_one(held, foreign):
    """And so is one photograph that is given twice."""
    first, settings = held[1][0], CaptureSettings(preset="instant", detail=192)
    alone = capture_photo(first, settings).estimate.exemplar
    for other, why in ((foreign, "leather_9 was left out: only"), (first, "counts once")):
        result = capture_photo(first, settings, others=[other])
        assert (result.estimate.exemplar.stacked() == alone.stacked()).all()
        said = " ".join(warnings(result))
        assert why in said and f"The maps are those of {first.name} alone" in said
        report = result.several.document()
        assert report["first_alone"] and [one["name"] for one in report["photographs"]] == [
            first.name
        ]
        assert result.photographs == 1


def test_notes_of_the_first_stay_where_another_defines_the_frame(held):
    first, second = held[1][:2]
    smeared = replace(first, pixels=cv2.blur(first.pixels, (9, 1)), notes=("colours assumed",))
    settings = CaptureSettings(preset="instant", detail=128)
    result = capture_photo(smeared, settings, others=[second])
    assert result.photo.name == second.name and "colours assumed" in result.photo.notes


def test_a_hand_holds_the_phone_as_it_is_told():
    cameras = hold(PHONE, Hand(shaken=0.0, turned=0.0, aside=0.3), 5, 0)
    distance = 1.0 / math.tan(math.radians(PHONE.fov / 2.0))
    for camera in cameras[1:]:
        assert np.hypot(*camera.place[:2]) == pytest.approx(0.3 * distance, rel=1e-6)
        assert 5.0 < math.degrees(camera.tilt) < 25.0


@pytest.mark.parametrize("steep", [1.0, 1.5])
def test_two_photographs_tell_how_strong_relief_is_of_which_half_was_read(steep):
    """Nothing is measured across their baseline: a mean of both reliefs is weaker than either."""
    one, two = (replace(maps, height=steep * maps.height) for maps in (grainy(7), grainy(8)))
    views, light = seen([one] * 2, 0.005)
    read = replace(flattened(one), height=0.5 * (one.height + two.height))
    found = _solved(views, read, light)
    true, before, after = (
        float(parameters_of(maps)[SLOPES].square().mean()) for maps in (one, read, found.maps)
    )
    assert before < 0.5 * true and 0.85 * true < after < 1.15 * true


def test_noise_of_short_waves_that_two_photographs_understate_is_taken_off():
    rng = np.random.default_rng(0)
    true, predicted = grainy(9, (128, 128)).height[0].numpy(), np.zeros((128, 128), np.float32)
    noise = np.float32(true.std()) * rng.normal(size=true.shape).astype(np.float32)
    shown, changes = true + noise, [0.5 * noise, 0.5 * noise]
    found, less = (denoised(shown, predicted, changes, understated=u) for u in (1.0, 4.0))
    before, after = split(found), split(less)
    for one, other in zip(before[:3], after[:3], strict=True):  # down to 8 texels
        np.testing.assert_allclose(one, other, atol=1e-6)
    for one, other in zip(before[4:6], after[4:6], strict=True):
        assert np.square(other).mean() < 0.6 * np.square(one).mean()


def test_energies_of_octaves_belong_to_wavelengths_not_to_texels():
    maps = grainy(7)
    views, light = seen([maps] * 2, 0.005)
    found = _solved(views, flattened(maps), light)
    finer = maps.map(lambda m: m.repeat_interleave(2, -1).repeat_interleave(2, -2))
    assert len(found.slope_energies) == 6  # from 256 to 4 texels
    assert found.slope_statistics_on(maps) == (found.prediction_error, found.slope_energies)
    assert found.slope_statistics_on(finer) == (found.prediction_error, found.slope_energies[1:])


# Cameras and lights as they are drawn.


EXEMPLAR = np.full((48, 64, 3), 0.5, np.float32)
BLUE, GREEN, SPARK = (120, 200, 255), (140, 230, 150), (255, 214, 90)


def report(**changes):
    straight = PosedCamera.of(FlashSetup(fov=60.0))
    aside = replace(straight, place=straight.place + np.array([0.9, 0.0, 0.0]))
    cameras = {"oak_1.jpg": straight, "oak_2.jpg": aside}
    views = tuple(RegisteredView(SimpleNamespace(name=n), c) for n, c in cameras.items())
    result = SetReport(
        views, (0.02, 0.03), (0.04, 0.05), (LeftOut("cat.jpg", "it shows something else"),),
        (0.9, 0.3, 0.4, 0.8), (0.0, 0.2, 0.0), Mosaic.own((64, 48)),
    )  # fmt: skip
    return replace(result, **changes)


def middle(picture, colour):
    """Mean place (x, y) of a colour in the view from above."""
    codes = np.asarray(picture)[:, : picture.width // 3]
    rows, columns = np.nonzero((codes == colour).all(axis=2))
    assert rows.size
    return columns.mean(), rows.mean()


def test_cameras_stand_where_they_stood_and_flashes_beside_them():
    picture = draw_set(report(), EXEMPLAR, 1200)
    assert picture.size == (1200, 300)
    first, second = (middle(picture, colour) for colour in (BLUE, GREEN))
    assert second[0] > first[0] + 40
    # The flash lies upwards of its camera.
    assert middle(picture, SPARK)[1] < first[1] - 5


def test_what_each_told_is_told():
    said = [line for line, _ in set_report_lines(report())]
    first = "1 oak_1.jpg: re-rendered within 2.0 %, predicted from the others within 4.0 %"
    assert said[0] == first
    assert said[2] == "left out: cat.jpg, it shows something else"
    assert said[3].startswith("measured, not predicted: diffuse 90 %, specular 30 %")


@pytest.mark.parametrize("turned", [False, True])
def test_a_photograph_is_shown_beside_its_prediction_and_their_difference(turned):
    true, predicted = np.full((48, 64, 3), 0.2, np.float32), np.full((48, 64, 3), 0.3, np.float32)
    result = report(pictures=(Prediction(1, true, true), Prediction(2, true, predicted)))
    drawn = np.asarray(draw_predicted(result, 1211, turned=turned)).astype(int)
    # Of either: photographed, predicted, difference.
    here = drawn[100, [100, 230, 360, 500, 630, 760]]
    codes = np.rint(255.0 * srgb_picture(np.array([0.2, 0.3], np.float32)))
    assert here[:2, 0] == pytest.approx(codes[[0, 0]], abs=1)
    assert here[3:5, 0] == pytest.approx(codes, abs=1)
    assert here[2, 0] == 128
    assert here[5, 0] == pytest.approx(127.5 + 2 * (codes[1] - codes[0]), abs=2)


def test_an_interrupted_set_has_predicted_nothing():
    assert "predicted" not in next(set_report_lines(report(predicted=())))[0]


def test_a_photograph_without_flash_has_a_camera_and_no_spark():
    result = report()
    dark = replace(result, views=(result.views[0], replace(result.views[1], flash=False)))
    drawn = [np.asarray(draw_set(one, EXEMPLAR, 900)) for one in (result, dark)]
    sparks = [int((picture == SPARK).all(-1).sum()) for picture in drawn]
    assert 0 < sparks[1] < sparks[0]
    said = [line for line, _ in set_report_lines(dark)]
    assert said[1].endswith("without flash") and "predicted" not in said[1]
