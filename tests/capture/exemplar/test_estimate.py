"""The estimate of the exemplar, its network, and its aligned maps."""

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from arrays import photo_from_array
from materials import a_material
from photographed import photographed, whole_plane
from PIL import Image
from typer.testing import CliRunner

from matcap.brdf.folder import find_mapsets, read_mapset
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import (
    ExemplarEstimate,
    KnownMeans,
    continued_grooves,
    estimate_exemplar,
)
from matcap.capture.exemplar.network.network import (
    ANSWERS,
    ERRORS,
    INPUTS,
    SHIPPED,
    ExpectedErrors,
    Inverse,
    InverseConfig,
    NetworkAnswer,
    NetworkInputs,
    load_inverse,
    network_inputs,
    read_inverse,
)
from matcap.capture.exemplar.predict import confidence_of, map_set_of, predict_maps
from matcap.capture.exemplar.refine import narrowed
from matcap.capture.rectified import Observation, Rectified, lit, network_input, seen_share
from matcap.capture.settings import CaptureClock
from matcap.cli.main import command_line
from matcap.errors import MatcapError, UsageError
from matcap.example.exemplar import Exemplar
from matcap.field.material import Material
from matcap.files.color import srgb_encode
from matcap.files.exr import read_exr
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, camera_in_plane, plane_points
from matcap.flash.light import FlashLight, Uniform, render_flash, uniform_radiance
from matcap.flash.rectify import Plane, inside, plane_of
from matcap.space.between import blend

# From a photograph's plane to the exemplar.


def _plane(clip: float = 1e9):
    shot = photographed(0.15, 0.15, width=256, height=192)
    clipped = shot.linear.clamp_max(clip)
    return plane_of(clipped, (clipped < clip).all(0)), shot.uniform, shot


def _found(plane: Plane, coarse: CoarseFit, network: Inverse | None = None) -> ExemplarEstimate:
    rectified = Rectified(None, coarse, plane, (), network_input(plane))
    return estimate_exemplar(rectified, network or load_inverse(), CaptureClock(None))


def test_the_exemplar_re_renders_to_its_photograph() -> None:
    plane, coarse, shot = _plane()
    found = _found(plane, coarse)
    assert found.error < 0.05
    maps = map_set_of(found.exemplar)
    assert maps.size == plane.size and bool(torch.isfinite(maps.stacked()).all())
    # Brightness is the truth's, whatever the network has learnt yet.
    ratio = maps.diffuse.mean((1, 2)) / shot.maps.diffuse.mean((1, 2))
    assert float((ratio.log()).abs().max()) < 0.25


def test_a_black_and_white_weave_is_as_bright_as_photographed() -> None:
    """Strong contrast of log albedo does not change the mean radiance."""
    shot = photographed(0.05, 0.0, width=256, height=192)
    y, x = np.mgrid[0:192, 0:256]
    tone = np.array([0.8, -1.2, -3.5], np.float32)[(x // 12) % 2 + (y // 12) % 2]
    maps = replace(shot.maps, diffuse=shot.maps.diffuse * torch.from_numpy(tone).exp())
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    coarse = replace(shot.uniform, diffuse=tuple(maps.diffuse.mean((1, 2)).tolist()))
    found = _found(whole_plane(linear), coarse)
    again = render_flash(map_set_of(found.exemplar), shot.uniform.setup, shot.points)
    ratio = again.mean((1, 2)) / linear.mean((1, 2)) / found.scale
    assert float(ratio.log().abs().max()) < 0.03


def test_white_tiles_keep_their_texture_where_the_fit_is_too_bright() -> None:
    """Albedo of the fit is below 1, that of the white tiles is not: it would be cut there."""
    shot = photographed(0.02, 0.1, width=256, height=192)
    y, x = np.mgrid[0:192, 0:256]
    white = (x // 32 + y // 32) % 2 == 0
    tone = torch.from_numpy(np.where(white, 0.0, -2.0).astype(np.float32))
    maps = replace(shot.maps, diffuse=shot.maps.diffuse * tone.exp())
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    mean = tuple(maps.diffuse.mean((1, 2)).tolist())
    coarse = replace(shot.uniform, diffuse=mean).scaled(0.7 / max(mean))
    found = _found(whole_plane(linear), coarse)
    texture, true = (each.diffuse[:, white].log() for each in (map_set_of(found.exemplar), maps))
    assert float(texture.std(1).min()) > 0.7 * float(true.std(1).min())
    again = render_flash(map_set_of(found.exemplar), coarse.setup, shot.points)
    ratio = again.mean((1, 2)) / linear.mean((1, 2)) / found.scale
    assert float(ratio.log().abs().max()) < 0.05


def test_an_untrained_network_gives_maps_within_their_ranges() -> None:
    plane, coarse, _ = _plane()
    torch.manual_seed(1)
    network = Inverse(InverseConfig(widths=(8, 8, 12), context=8)).eval().requires_grad_(False)
    exemplar = _found(plane, coarse, network).exemplar  # checks ranges when it is made
    assert float(np.abs(exemplar.height).max()) < 1.0


def test_confidence_is_zero_where_nothing_was_seen() -> None:
    plane, coarse, _ = _plane(clip=float(_plane()[2].linear.quantile(0.98)))
    found = _found(plane, coarse)
    unseen = ~plane.valid.numpy()
    assert unseen.any() and float(found.exemplar.confidence[:, unseen].max()) == 0.0
    assert float(found.exemplar.confidence[:, ~unseen].mean()) > 0.2


def test_texels_crushed_to_black_are_not_black_albedo() -> None:
    """A corner of no light says nothing: its albedo is the others', and nobody trusts it."""
    plane, coarse, _ = _plane()
    crushed = plane.linear.clone()
    crushed[:, :80, :80] = 2e-4
    found = _found(replace(plane, linear=crushed), coarse).exemplar
    corner = (slice(None), slice(8, 56), slice(8, 56))
    assert float(found.confidence[corner].max()) == 0.0
    assert float(found.diffuse[corner].mean()) > 0.5 * float(found.diffuse[:, 100:].mean())


def test_texels_outside_of_the_photograph_are_no_highlight() -> None:
    plane, coarse, _ = _plane()
    setup = replace(coarse.setup, tilt=(0.08, -0.08))
    height, width = plane.valid.shape
    seen = torch.from_numpy(inside((height, width), setup))
    assert 0 < int((~seen).sum()) < height * width // 10
    reached = replace(plane, valid=plane.valid & seen)
    found = _found(reached, replace(coarse, setup=setup)).exemplar
    beyond = ~seen.numpy()
    ratio = found.diffuse[:, beyond].mean() / found.diffuse[:, ~beyond].mean()
    assert 0.85 < float(ratio) < 1.15  # 1.35 where the network is told of glare there
    assert float(found.confidence[:, beyond].max()) == 0.0


def test_dark_grains_in_lit_places_are_valid() -> None:
    radiance = torch.full((3, 64, 64), 0.05)
    radiance[:, ::9, ::9] = 1e-5
    assert bool(lit(radiance).all()) and not lit(0.01 * radiance).any()


def _expected(log: float) -> ExpectedErrors:
    return ExpectedErrors.from_stacked(torch.full((ERRORS, 64, 96), log))


def test_confidence_falls_with_the_expected_error() -> None:
    seen = np.ones((64, 96), np.float32)
    sure, unsure = (confidence_of(_expected(e), seen, max(seen.shape)) for e in (-4.0, 0.0))
    assert (sure > unsure).all() and sure.max() <= 1.0 and unsure.min() >= 0.0


def test_visibility_is_zero_in_a_hole_and_lower_beside_it() -> None:
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:, 20:30, 40:60] = False
    seen = seen_share(measured)
    assert seen[20:30, 40:60].max() == 0.0
    assert seen[19, 45:55].max() < 0.4  # what glare and interpolation touch
    assert seen[:15].min() > 0.95 and seen[35:].min() > 0.95


def test_visibility_beside_a_sparkle_stays_high() -> None:
    """One texel in twenty clips, in all channels: the picture is seen."""
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:] = torch.from_numpy(np.random.default_rng(0).random((64, 96)) > 0.05)
    assert np.median(seen_share(measured)) > 0.85


@pytest.mark.parametrize(("clipped", "share"), [(0, 1.0), (1, 1.0), (2, 0.0), (3, 0.0)])
def test_two_unclipped_channels_suffice_for_visibility(clipped: int, share: float) -> None:
    """Red cloth: inpainted where red alone clipped, a knit had a lump of displaced stitches."""
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:clipped] = False
    assert (seen_share(measured) == share).all()


def test_confidence_counts_every_error_in_its_own_units() -> None:
    """Slope's are the smallest that count, then log albedo's; F0's and roughness's are alike."""
    seen = np.ones((64, 96), np.float32)
    confidence = confidence_of(_expected(-1.5), seen, max(seen.shape))
    albedo, f0, roughness, slope = confidence.mean((1, 2))
    assert slope < 0.7 * albedo and albedo < 0.8 * f0 and f0 == roughness


def test_weights_are_refused_when_damaged_or_missing(tmp_path: Path) -> None:
    path = tmp_path / "inverse.safetensors"
    path.write_bytes(SHIPPED.read_bytes()[:-100])
    with pytest.raises(MatcapError, match="damaged"):
        read_inverse(path)
    with pytest.raises(MatcapError, match="damaged"):
        read_inverse(tmp_path / "missing")


def test_predictions_have_no_grid_of_two_texels():
    """Differences do not alternate; those without its two middle layers do by 0.03."""
    shot = photographed(0.15, 0.15, width=320, height=240)
    observed = Observation.of(whole_plane(shot.linear), shot.uniform)
    with torch.no_grad():
        _, prediction = predict_maps(observed, load_inverse())
    for plane in (prediction.residuals.height[0], prediction.residuals.diffuse[1]):
        for turned in (plane, plane.T):
            step = turned.diff(dim=1)[:, : turned.shape[1] // 2 * 2 - 2]
            mesh = 0.5 * (step[:, ::2] - step[:, 1::2]).mean()
            assert abs(float(mesh)) < 0.02 * float(step.square().mean().sqrt())


@pytest.mark.parametrize(
    ("roughness", "steeper", "least", "most"),
    [(0.15, 10.0, 0.05, 0.36), (0.15, 1.0, 0.7, 1.0), (0.7, 10.0, 0.7, 1.0)],
    ids=["glossy and too steep", "glossy and right", "matte"],
)
def test_relief_is_no_wider_than_the_highlight(
    roughness: float, steeper: float, least: float, most: float
) -> None:
    shot = photographed(0.02, 0.1, width=320, height=240)
    uniform = replace(shot.uniform, roughness=roughness)
    maps = replace(shot.maps, roughness=torch.full_like(shot.maps.roughness, roughness))
    linear = render_flash(maps, uniform.setup, shot.points)
    plane = whole_plane(linear)
    observed, prediction = predict_maps(Observation.of(plane, uniform), load_inverse())
    guess = replace(
        prediction.classes.constrained(prediction.residuals, torch.ones(linear.shape[1:])),
        height=steeper * shot.maps.height / shot.maps.texel_size,
    )
    found = narrowed(observed, replace(prediction, residuals=guess)).residuals
    assert least <= float(found.height.std() / guess.height.std()) <= most


# The inverse network: what it is told, what it answers, and how that is read.


SETUP = FlashSetup(fov=60.0, offset=(0.1, -0.05, 0.0), tilt=(0.05, -0.03), intensity=(8.0,) * 3)
UNIFORM = Uniform((0.3, 0.2, 0.1), 0.04, 0.5, SETUP)
TINY = InverseConfig(widths=(8, 8, 12), context=8)


def _inputs(height: int, width: int) -> torch.Tensor:
    """(1, INPUTS, height, width) of all texels valid, some gloss everywhere."""
    inputs = NetworkInputs.from_stacked(torch.randn(1, INPUTS, height, width))
    gloss = inputs.gloss.abs().clamp_max(1.0)
    return replace(inputs, valid=torch.ones_like(gloss), gloss=gloss).stacked()


def _points(width: int, height: int) -> torch.Tensor:
    return plane_points(0, 0, width, height, (width, height), dtype=torch.float32)


def _flat(width: int, height: int) -> MapSet:
    one = torch.ones(1, height, width)
    albedo = torch.tensor(UNIFORM.diffuse)[:, None, None] * one
    return MapSet(albedo, 0.04 * one, 0.5 * one, 0.0 * one, 2.0 / width)


def test_uniform_radiance_equals_rendered_flat_maps() -> None:
    points = _points(64, 48)
    expected = render_flash(_flat(64, 48), SETUP, points)
    found, diffuse = uniform_radiance(UNIFORM, FlashLight.of(SETUP, points))
    assert torch.allclose(found, expected, rtol=1e-4) and bool((diffuse < found).all())


def test_a_photograph_of_the_uniform_material_has_no_residual() -> None:
    points = _points(256, 192)
    linear = render_flash(_flat(256, 192), SETUP, points)
    inputs = network_inputs(linear, torch.ones(192, 256, dtype=torch.bool), UNIFORM, points)
    assert inputs.stacked().shape == (INPUTS, 192, 256) and float(inputs.log.abs().max()) < 0.01


@pytest.mark.parametrize("fov", [40.0, 65.0, 90.0])
def test_slope_sensitivity_of_matte_is_the_tangent_of_the_light(fov: float) -> None:
    """d log(n.l) / d slope at a flat place is -l_xy / l_z."""
    setup = FlashSetup(fov=fov, offset=(0.08, 0.02, 0.0))
    matte = Uniform((0.5, 0.5, 0.5), 1e-6, 0.99, setup)
    points = _points(64, 48)
    inputs = network_inputs(
        torch.full((3, 48, 64), 0.2), torch.ones(48, 64, dtype=torch.bool), matte, points
    )
    light = camera_in_plane(setup)[1].float()[:, None, None]
    tangent = (light - points)[:2] / (light - points)[2:]
    assert torch.allclose(inputs.tangent, tangent, atol=0.01)
    assert torch.allclose(inputs.slope_sensitivity, -tangent, atol=0.02)


def test_the_network_takes_any_aspect_and_starts_with_the_photograph_as_albedo() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY).eval()
    for height, width in ((32, 64), (96, 32)):
        inputs = _inputs(height, width)
        with torch.no_grad():
            answer = network(inputs)
        assert answer.shape == (1, ANSWERS, height, width)
        albedo = NetworkAnswer.from_stacked(answer).residuals.diffuse
        assert float((albedo - NetworkInputs.from_stacked(inputs).log).abs().mean()) < 0.5


def test_one_corner_of_the_input_changes_the_opposite_one() -> None:
    """Pooled context reaches farther than any convolution does."""
    torch.manual_seed(0)
    network = Inverse(TINY).eval()
    inputs = _inputs(256, 256)
    changed = inputs.clone()
    changed[..., :32, :32] += 2.0
    with torch.no_grad():
        apart = (network(inputs) - network(changed))[..., -16:, -16:]
    assert float(apart.abs().max()) > 1e-6


def test_gradients_reach_every_weight() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY)
    network(_inputs(32, 32)).square().mean().backward()
    silent = [name for name, p in network.named_parameters() if not p.grad.abs().sum() > 0]
    assert silent == []


def test_a_clipped_hot_spot_and_darkness_give_finite_inputs() -> None:
    points = _points(64, 48)
    linear = torch.zeros(3, 48, 64)
    linear[:, 20:28, 28:36] = 1.0
    valid = (linear < 0.98).all(0)
    polished = Uniform((0.001, 0.001, 0.001), 0.9, 0.03, SETUP)
    inputs = network_inputs(linear, valid, polished, points)
    assert bool(torch.isfinite(inputs.stacked()).all())
    assert math.isclose(float(inputs.valid.mean()), float(valid.float().mean()), rel_tol=1e-5)


# `capture --aligned` and `--generator example`, as a user gives them.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("aligned")
    shot = photographed(0.15, 0.2, width=320, height=240)
    linear = (shot.linear / shot.linear.quantile(0.995)).permute(1, 2, 0).numpy()
    photo = out / "bumps.png"
    codes = (srgb_encode(linear.clip(0.0, 1.0))[..., ::-1] * 65535).astype(np.uint16)
    cv2.imwrite(str(photo), codes)
    result = CliRunner().invoke(
        command_line(),
        ["capture", str(photo), "-o", str(out), "--preset", "instant", "--size", "64x64",
         "--detail", "320", "--aligned", "--generator", "example", "-q"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return out / photo.stem


@pytest.mark.capture
def test_the_exemplar_is_written_beside_the_material(folder: Path) -> None:
    name = folder.name
    maps, document = read_mapset(folder / f"{name}_photo.json")
    trusted = read_exr(folder / f"{name}_photo_confidence.exr").pixels
    assert trusted.shape == (maps.size[1], maps.size[0], 4)
    assert 0.0 <= trusted.min() <= trusted.max() <= 1.0
    assert document["provenance"]["of"] == "the photographed piece"
    # A folder still means its material's own set.
    assert find_mapsets(folder) == [folder / f"{name}.json"]


@pytest.mark.capture
def test_the_material_holds_its_exemplar(folder: Path) -> None:
    material = Material.load(folder / f"{folder.name}.matcap")
    assert set(material.generators) == {"example"}
    assert material.maps(48, 48, seed=2).size == (48, 48)
    with pytest.raises(UsageError, match="no decoder of its own"):
        material.maps(48, 48, generator="decoder")


@pytest.mark.capture
def test_an_exemplar_is_blended_with_a_decoder(folder: Path) -> None:
    material = Material.load(folder / f"{folder.name}.matcap")
    drawn = a_material("drawn", across=256)
    between = blend(material, drawn, 0.5)
    assert set(between.generators) == {"example"}
    assert between.texel_size == pytest.approx((material.texel_size * drawn.texel_size) ** 0.5)
    assert bool(between.maps(48, 48).diffuse.isfinite().all())
    assert blend(material, drawn, 0.0) is material


@pytest.mark.capture
def test_the_preview_shows_exemplar_and_photograph(folder: Path) -> None:
    with Image.open(folder / "preview.png") as sheet:
        whole = np.asarray(sheet).astype(int)
    for lines in range(1, 8):  # of the verdict, above two blocks of one size
        blocks = whole[20 + 28 * lines :].reshape(2, -1, whole.shape[1], 3)
        (first, second), (own_first, own_second) = (
            [block[100:400, x : x + 500] for x in (20, 20 + (blocks.shape[2] - 12) // 4)]
            for block in blocks
        )
        equal = (first == own_first).mean()  # all but the rectangle where the field differs most
        if equal > 0.95:
            break
    assert equal > 0.95 and first.std() > 1.0
    # The piece re-renders to the photograph texel by texel; more of the material cannot.
    away, own_away = (np.abs(again - first).mean() for again in (second, own_second))
    assert own_away < 0.5 * away


@pytest.mark.capture
def test_the_report_states_the_errors_of_the_exemplar(folder: Path) -> None:
    report = json.loads((folder / "report.json").read_text())
    values = report["exemplar"]
    assert 0.0 <= values["error"] < 0.5 and 0.0 <= values["left_out"] < 0.5
    assert 0.0 < values["relief_spectrum"]["relief"] < 1.0
    assert set(values["confidence"]) == {"diffuse", "specular", "roughness", "height"}
    assert 0.0 < values["level"] < 1.0 and 0.39 < values["level_deviation"] < 2.0
    factor = math.exp(values["level_deviation"])
    level = f"Mean albedo {values['level']:.2g}, uncertain by a factor of {factor:.1f}"
    assert any(level in note for note in report["notes"])


def test_known_means_replace_what_a_photograph_leaves_open():
    planes = np.random.default_rng(0).uniform(0.1, 0.3, (5, 8, 8)).astype(np.float32)
    exemplar = Exemplar(
        diffuse=planes[:3], specular=planes[3:4], roughness=planes[4:], height=0 * planes[:1],
        confidence=np.ones((4, 8, 8), np.float32), texel_size=0.01,
    )  # fmt: skip
    known, dielectric = KnownMeans(albedo=0.5, roughness=0.4), np.zeros((8, 8), np.float32)
    assert known.scale(exemplar, dielectric) * exemplar.diffuse.mean() == pytest.approx(0.5)
    assert known.scale(exemplar, 1 + dielectric) * exemplar.specular.mean() == pytest.approx(0.5)
    assert known.rougher(exemplar).roughness.mean() == pytest.approx(0.4, rel=1e-3)
    assert KnownMeans(absolute=True).scale(exemplar, dielectric) == 1.0


@pytest.mark.parametrize("metal", [True, False])
def test_metal_or_dielectric_by_hand_decides_the_coarse_fit(metal):
    shot = photographed(0.15, 0.15, width=256, height=192)
    coarse = fit_coarse(photo_from_array(shot.linear.movedim(0, -1).numpy()), known_metal=metal)
    assert coarse.conductor is metal and coarse.by_hand


@pytest.mark.parametrize("turned", [False, True])
def test_copies_do_not_cut_grooves_off(turned: bool) -> None:
    """Where nothing is seen, grooves go on from both sides instead of the copied ones."""
    rng = np.random.default_rng(3)
    lines = np.convolve(rng.standard_normal(160), [0.25, 0.5, 0.25], "same")[:, None]
    true = np.repeat(lines / lines.std(), 160, axis=1).astype(np.float32)
    copied = np.zeros(true.shape, np.bool_)
    copied[60:100, 60:100] = True
    height = np.where(copied, np.roll(true, 37, axis=0), true)
    planes = (height, true, ~copied, copied)
    if turned:
        planes = tuple(np.ascontiguousarray(plane.T) for plane in planes)
    whole = continued_grooves(*planes, across=0.0 if turned else math.pi / 2.0)
    whole = whole.T if turned else whole
    np.testing.assert_allclose(whole[~copied], true[~copied], atol=1e-4)
    hole = np.s_[64:96, 64:96]
    assert np.corrcoef(whole[hole].ravel(), true[hole].ravel())[0, 1] > 0.9
