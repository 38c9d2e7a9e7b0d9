"""From a photograph's plane to the exemplar."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.exemplar.estimate import (
    ExemplarEstimate,
    estimate_exemplar,
    map_set_of,
)
from matcap.capture.exemplar.network.network import (
    ERRORS,
    INPUTS,
    SHIPPED,
    ExpectedErrors,
    Inverse,
    InverseConfig,
    load_inverse,
    read_inverse,
)
from matcap.capture.exemplar.observation import Observation, lit, seen_share
from matcap.capture.exemplar.predict import _shift_averaged, confidence_of, predict_maps
from matcap.capture.exemplar.refine import narrowed
from matcap.capture.progress import CaptureClock
from matcap.capture.rectified import Rectified, network_input
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import Plane, plane_of
from matcap.flash.rectify import inside
from matcap.flash.render import render_flash


def _plane(clip: float = 1e9):
    shot = photographed(0.15, 0.15, width=256, height=192)
    clipped = shot.linear.clamp_max(clip)
    return plane_of(clipped, (clipped < clip).all(0)), shot.uniform, shot


def _found(plane: Plane, coarse: CoarseFit, network: Inverse | None = None) -> ExemplarEstimate:
    rectified = Rectified(None, coarse, plane, (), network_input(plane))
    return estimate_exemplar(rectified, network or load_inverse(), CaptureClock(None))


def test_the_piece_re_renders_to_its_photograph() -> None:
    plane, coarse, shot = _plane()
    found = _found(plane, coarse)
    assert found.error < 0.05
    maps = map_set_of(found.exemplar)
    assert maps.size == plane.size
    assert bool(torch.isfinite(maps.stacked()).all())
    # Brightness is the truth's, whatever the network has learnt yet.
    ratio = maps.diffuse.mean((1, 2)) / shot.maps.diffuse.mean((1, 2))
    assert float((ratio.log()).abs().max()) < 0.25


def test_a_black_and_white_weave_is_as_bright_as_photographed() -> None:
    """Strong contrast of log albedo does not change the mean radiance."""
    shot = photographed(0.05, 0.0, width=256, height=192)
    y, x = np.mgrid[0:192, 0:256]
    dark = (x // 12) % 2 + (y // 12) % 2
    tone = np.array([0.8, -1.2, -3.5], np.float32)[dark]
    maps = replace(shot.maps, diffuse=shot.maps.diffuse * torch.from_numpy(tone).exp())
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    mean = tuple(maps.diffuse.mean((1, 2)).tolist())
    coarse = replace(shot.uniform, diffuse=mean)
    found = _found(plane_of(linear, torch.ones(192, 256, dtype=torch.bool)), coarse)
    again = render_flash(map_set_of(found.exemplar), shot.uniform.setup, shot.points)
    ratio = again.mean((1, 2)) / linear.mean((1, 2)) / found.scale
    assert float(ratio.log().abs().max()) < 0.03


def test_even_an_untaught_network_gives_maps_within_their_ranges() -> None:
    plane, coarse, _ = _plane()
    torch.manual_seed(1)
    network = Inverse(InverseConfig(widths=(8, 8, 12), context=8)).eval().requires_grad_(False)
    exemplar = _found(plane, coarse, network).exemplar  # checks ranges when it is made
    assert float(np.abs(exemplar.height).max()) < 1.0


def test_nothing_is_trusted_where_nothing_was_seen() -> None:
    plane, coarse, shot = _plane(clip=float(photographed(0.15, 0.15, width=256, height=192)
                                            .linear.quantile(0.98)))  # fmt: skip
    found = _found(plane, coarse)
    unseen = ~plane.valid.numpy()
    assert unseen.any()
    assert float(found.exemplar.confidence[:, unseen].max()) == 0.0
    assert float(found.exemplar.confidence[:, ~unseen].mean()) > 0.2


def test_what_is_crushed_to_black_is_not_read_as_black() -> None:
    """A corner of no light says nothing: its albedo is the others', and nobody trusts it."""
    plane, coarse, _ = _plane()
    crushed = plane.linear.clone()
    crushed[:, :80, :80] = 2e-4
    found = _found(replace(plane, linear=crushed), coarse).exemplar
    corner = (slice(None), slice(8, 56), slice(8, 56))
    assert float(found.confidence[corner].max()) == 0.0
    assert float(found.diffuse[corner].mean()) > 0.5 * float(found.diffuse[:, 100:].mean())


def test_what_the_photograph_does_not_reach_is_not_taken_for_glare() -> None:
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


def test_dark_grains_in_the_light_are_seen() -> None:
    radiance = torch.full((3, 64, 64), 0.05)
    radiance[:, ::9, ::9] = 1e-5
    assert bool(lit(radiance).all())
    assert not lit(0.01 * radiance).any()


def _expected(log: float) -> ExpectedErrors:
    return ExpectedErrors.from_stacked(torch.full((ERRORS, 64, 96), log))


def test_confidence_falls_with_the_error_to_be_expected() -> None:
    seen = np.ones((64, 96), np.float32)
    sure, unsure = (confidence_of(_expected(e), seen, max(seen.shape)) for e in (-4.0, 0.0))
    assert (sure > unsure).all()
    assert sure.max() <= 1.0 and unsure.min() >= 0.0


def test_nothing_is_seen_in_a_hole_and_less_beside_it() -> None:
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:, 20:30, 40:60] = False
    seen = seen_share(measured)
    assert seen[20:30, 40:60].max() == 0.0
    assert seen[19, 45:55].max() < 0.4  # what glare and interpolation touch
    assert seen[:15].min() > 0.95 and seen[35:].min() > 0.95


def test_sparkles_cost_no_more_than_themselves() -> None:
    """One texel in twenty clips, in all channels: the picture is seen."""
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:] = torch.from_numpy(np.random.default_rng(0).random((64, 96)) > 0.05)
    seen = seen_share(measured)
    assert np.median(seen) > 0.85


@pytest.mark.parametrize(("clipped", "share"), [(0, 1.0), (1, 1.0), (2, 0.0), (3, 0.0)])
def test_two_channels_show_a_texture_whose_third_one_clips(clipped: int, share: float) -> None:
    """Red cloth: inpainted where red alone clipped, a knit had a lump of displaced stitches."""
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    measured[:clipped] = False
    assert (seen_share(measured) == share).all()


def test_confidence_counts_every_error_in_its_own_units() -> None:
    """Slope's are the smallest that count, then log albedo's; F0's and roughness's are alike."""
    seen = np.ones((64, 96), np.float32)
    albedo, f0, roughness, slope = confidence_of(_expected(-1.5), seen, max(seen.shape)).mean(
        (1, 2)
    )
    assert slope < 0.7 * albedo and albedo < 0.8 * f0
    assert f0 == roughness


def test_weights_are_refused_when_damaged_or_missing(tmp_path: Path) -> None:
    path = tmp_path / "inverse.safetensors"
    path.write_bytes(SHIPPED.read_bytes()[:-100])
    with pytest.raises(MatcapError, match="damaged"):
        read_inverse(path)
    with pytest.raises(MatcapError, match="damaged"):
        read_inverse(tmp_path / "missing")


def test_what_is_read_has_no_mesh_of_two_texels():
    """Under a network whose head differs by place: what alternates along rows or columns goes."""
    network = Inverse(InverseConfig((16, 16), 16)).eval()
    with torch.no_grad():
        network.head.bias.copy_(torch.randn(network.head.bias.shape, generator=_generator(1)))
        inputs = torch.full((INPUTS, 64, 96), 0.2)
        read = _shift_averaged(network, inputs)[3:6, 16:48, 16:80]
        alone = network(inputs[None])[0, 3:6, 16:48, 16:80]
    for along in (-1, -2):
        mesh, before = (float(p.diff(dim=along).abs().mean()) for p in (read, alone))
        assert mesh < 0.1 * before


def _generator(seed):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize(
    ("roughness", "steeper", "least", "most"),
    [(0.15, 10.0, 0.05, 0.36), (0.15, 1.0, 0.7, 1.0), (0.7, 10.0, 0.7, 1.0)],
    ids=["glossy and too steep", "glossy and right", "matte"],
)
def test_relief_is_no_wider_than_the_highlight(
    roughness: float, steeper: float, least: float, most: float
) -> None:
    shot = photographed(0.02, 0.1)
    uniform = replace(shot.uniform, roughness=roughness)
    maps = replace(shot.maps, roughness=torch.full_like(shot.maps.roughness, roughness))
    linear = render_flash(maps, uniform.setup, shot.points)
    plane = plane_of(linear, torch.ones(linear.shape[1:], dtype=torch.bool))
    observed, prediction = predict_maps(Observation.of(plane, uniform), load_inverse())
    guess = replace(
        prediction.classes.constrained(prediction.residuals, torch.ones(linear.shape[1:])),
        height=steeper * shot.maps.height / shot.maps.texel_size,
    )
    found = narrowed(observed, replace(prediction, residuals=guess)).residuals
    assert least <= float(found.height.std() / guess.height.std()) <= most
