"""Inpainting under the highlight."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from photographed import SETUP, Photographed, in_8_bits, photographed, whole_plane

from matcap.capture.exemplar.inpaint import Copies, composed, inpainted, transport
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.exemplar.predict import albedo_weight, exemplar_of, predict_maps
from matcap.capture.exemplar.refine import refine_maps
from matcap.capture.rectified import Observation
from matcap.example.exemplar import Exemplar
from matcap.flash.highlight import remaining_highlight
from matcap.flash.light import render_flash
from matcap.statistics.lattice import Wave

# Rings of albedo around the mirror point.


HEIGHT, WIDTH = 384, 512
MIRROR = (230.0, 180.0)
KNOWN = np.ones((HEIGHT, WIDTH), np.bool_)


def texture(seed: int, grain: float = 3.0, contrast: float = 0.3) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), grain)
    return np.exp(contrast * blurred / blurred.std() - 1.5)[None].repeat(3, 0).clip(0.0, 1.0)


def away(mirror: tuple[float, float]) -> np.ndarray:
    rows, columns = np.indices((HEIGHT, WIDTH))
    return np.hypot(columns - mirror[0], rows - mirror[1]).astype(np.float32)


@pytest.mark.parametrize("radius", [16.0, 40.0])
@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_a_disc_is_found_within_its_radius(radius, gain):
    disc = away(MIRROR) < radius
    found = remaining_highlight(texture(0) * np.where(disc, gain, 1.0), KNOWN, away(MIRROR))
    assert found[disc].all() and away(MIRROR)[found].max() < radius + 24.0


def test_a_ring_is_found_with_what_it_surrounds_if_it_is_near():
    for radius, near in ((12.0, True), (60.0, False)):
        ring = np.abs(away(MIRROR) - radius) < 6.0
        found = remaining_highlight(texture(1) * np.where(ring, 2.0, 1.0), KNOWN, away(MIRROR))
        assert found[away(MIRROR) < radius].all() if near else not found.any()


@pytest.mark.parametrize("grain", [1.0, 3.0, 12.0])
def test_a_texture_has_no_highlight_residue(grain):
    rng = np.random.default_rng(5)
    hits = 0
    for seed in range(20):
        mirror = (float(rng.uniform(150, 360)), float(rng.uniform(120, 260)))
        hits += bool(remaining_highlight(texture(seed, grain), KNOWN, away(mirror)).any())
    assert hits <= 2


def test_a_spot_away_from_the_mirror_point_is_kept():
    spot = away((400.0, 100.0)) < 20.0
    found = remaining_highlight(texture(2) * np.where(spot, 2.0, 1.0), KNOWN, away(MIRROR))
    assert not found.any()


@pytest.mark.parametrize("off", [(30.0, 0.0), (-12.0, 24.0)])
def test_a_narrow_core_is_found_off_the_fitted_mirror_point(off):
    core = away((MIRROR[0] + off[0], MIRROR[1] + off[1])) < 10.0
    found = remaining_highlight(texture(8) * np.where(core, 2.5, 1.0), KNOWN, away(MIRROR))
    assert found[core].all() and found.sum() < 9 * core.sum()


def test_a_spot_like_others_is_kept():
    albedo = texture(9)
    for x in range(20, WIDTH, 64):
        for y in range(20, HEIGHT, 64):
            albedo[:, away((float(x), float(y))) < 10.0] = 0.9
    assert not remaining_highlight(albedo, KNOWN, away(MIRROR)).any()


def test_unknown_texels_are_no_evidence_of_a_spot():
    disc = away(MIRROR) < 16.0
    found = remaining_highlight(texture(3) * np.where(disc, 9.0, 1.0), ~disc, away(MIRROR))
    assert not found.any()


def test_a_halo_is_found_around_a_clipped_core():
    halo = (away(MIRROR) > 24.0) & (away(MIRROR) < 48.0)
    albedo = texture(6) * np.where(halo, 1.6, 1.0)
    albedo[:, away(MIRROR) < 28.0] = 0.5
    assert remaining_highlight(albedo, KNOWN, away(MIRROR))[away(MIRROR) < 44.0].all()


def test_shading_across_the_picture_does_not_hide_a_halo():
    halo = (away(MIRROR) > 8.0) & (away(MIRROR) < 40.0)
    albedo = texture(7, contrast=0.1) * np.where(halo, 0.85, 1.0)
    shaded = albedo * np.exp(np.linspace(-0.6, 0.6, WIDTH, dtype=np.float32))
    assert remaining_highlight(shaded, KNOWN, away(MIRROR))[halo].all()


def test_a_mirror_point_outside_of_the_picture_is_none():
    assert not remaining_highlight(texture(4), KNOWN, away((-300.0, 900.0))).any()


def test_a_spot_in_albedo_is_inpainted():
    shot = photographed(0.15, 0.15, width=512, height=384)
    plane = whole_plane(shot.linear)
    observed, prediction = predict_maps(Observation.of(plane, shot.uniform), load_inverse())
    prediction = refine_maps(observed, prediction)
    residuals = prediction.residuals
    disc = (observed.from_mirror_point / plane.texel_size).numpy() < 20.0
    white = residuals.diffuse + 0.8 * torch.from_numpy(disc)
    spotted = replace(prediction, residuals=replace(residuals, diffuse=white))
    plain, found = (
        inpainted(exemplar_of(observed, each), observed)[0].diffuse
        for each in (prediction, spotted)
    )
    inside = np.log(found[:, disc]).mean() - np.log(found[:, ~disc]).mean()
    before = np.log(plain[:, disc]).mean() - np.log(plain[:, ~disc]).mean()
    assert abs(inside - before) < 0.3


def test_black_gloss_keeps_the_relief_that_its_highlight_shows():
    """Albedo, which the highlight hides, hardly shows; relief shows there and nowhere else."""
    shot, observed = in_8_bits(0.0003, 4.0)
    observed, prediction = predict_maps(observed, load_inverse())
    exemplar = exemplar_of(observed, refine_maps(observed, prediction))
    _, copies = inpainted(exemplar, observed)
    light = cv2.blur(shot.linear[0].numpy(), (9, 9))
    lobe, dark = light > 0.01, light < 0.001  # below the third code of 8 bits
    assert lobe.mean() > 0.1 and dark.mean() > 0.1
    assert copies is None or copies.copied[lobe].mean() < 0.05
    assert exemplar.confidence[3][dark].mean() < 0.5 * exemplar.confidence[3][lobe].mean()


def test_albedo_counts_where_it_makes_the_light():
    weights = [albedo_weight(in_8_bits(albedo, 6.0)[1]) for albedo in (0.004, 0.04, 0.3)]
    assert weights[0] < 0.3 < weights[1] <= weights[2] == 1.0


# What glare hides is lent by places that look like it.


HOLE = (slice(100, 220), slice(180, 330))


def _hidden(shot: Photographed, confidence: float = 1e-3) -> Exemplar:
    """Maps whose albedo is told nothing of inside the hole: flat and pale there."""
    exemplar = _certain(shot)
    exemplar.confidence[:, *HOLE] = confidence
    exemplar.diffuse[:, *HOLE] = 0.8
    return exemplar


def _certain(shot: Photographed) -> Exemplar:
    maps = replace(shot.maps, diffuse=shot.maps.diffuse.clamp(0.0, 0.95))
    return Exemplar.certain(maps.stacked().numpy(), maps.texel_size)


def _lent(shot: Photographed, exemplar: Exemplar, hole: tuple[slice, ...] = ()) -> Exemplar:
    """Inpainted; the photograph is clipped in a hole, if any."""
    return _transported(shot, exemplar, hole)[0]


def _transported(
    shot: Photographed, exemplar: Exemplar, hole: tuple[slice, ...], waves: tuple[Wave, ...] = ()
) -> tuple[Exemplar, Copies | None]:
    valid = torch.ones(shot.linear.shape[1:], dtype=torch.bool)
    if hole:
        valid[hole] = False
    return transport(exemplar, shot.linear, valid, torch.ones_like(valid), shot.light, waves)


def _likeness(found: Exemplar, shot: Photographed) -> float:
    """Correlation of log albedo with the truth inside the hole."""
    truth = shot.maps.diffuse.log().numpy()[:, *HOLE]
    drawn = np.log(found.diffuse.clip(1e-3))[:, *HOLE]
    return float(np.corrcoef(truth.ravel(), drawn.ravel())[0, 1])


@pytest.fixture(scope="module")
def shot() -> Photographed:
    """A material of spots, some of them in every block."""
    shot = photographed(0.1, 0.0)
    y, x = np.mgrid[0:384, 0:512]
    spots = np.sin(x * 2 * np.pi / 21) * np.sin(y * 2 * np.pi / 21)
    tone = torch.from_numpy(0.5 * spots.astype(np.float32))
    maps = replace(shot.maps, diffuse=shot.maps.diffuse * tone.exp())
    return replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))


def test_an_inpainted_hole_has_the_statistics_of_the_rest(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    whole = _lent(shot, exemplar, HOLE)
    hole = np.log(whole.diffuse)[:, *HOLE]
    truth = shot.maps.diffuse.log().numpy()[:, *HOLE]
    assert np.abs(hole.mean((1, 2)) - truth.mean((1, 2))).max() < 0.2
    assert hole.std() == pytest.approx(truth.std(), rel=0.2)
    # Slow relief stays, and what is lent has slopes like the rest.
    steep = [np.gradient(e.height[0][HOLE], axis=1).std() for e in (exemplar, whole)]
    assert steep[1] == pytest.approx(steep[0], rel=0.2)
    assert np.array_equal(whole.confidence, exemplar.confidence)


def test_texels_far_from_the_hole_are_unchanged(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    whole = _lent(shot, exemplar)
    for name in ("diffuse", "specular", "roughness", "height"):
        before, after = getattr(exemplar, name), getattr(whole, name)
        assert np.array_equal(before[:, :70], after[:, :70]), name


def test_inpainted_texture_matches_what_the_photograph_shows(
    shot: Photographed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the picture to go by, the truth's own drawing comes back; by chance it does not."""
    y, x = np.mgrid[0:384, 0:512]
    along = np.where((x // 48 + y // 48) % 2, x, y)
    tone = torch.from_numpy(0.4 * np.sin(along * 2 * np.pi / 16).astype(np.float32))
    maps = replace(shot.maps, diffuse=0.2 * tone.exp().expand(3, -1, -1))
    shot = replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))
    exemplar = _hidden(shot)
    likeness = _likeness(_lent(shot, exemplar), shot)
    monkeypatch.setattr("matcap.capture.exemplar.inpaint._PHOTOGRAPH_WEIGHT", 0.0)
    assert likeness > max(0.7, _likeness(_lent(shot, exemplar), shot) + 0.1)


def test_checks_are_inpainted_in_phase(shot: Photographed) -> None:
    """Checks larger than a block came back in fragments: only their phase tells where each goes."""
    y, x = np.mgrid[0:384, 0:512]
    waves = Wave(1.0 / 86.0, 0.0004), Wave(0.0004, 1.0 / 96.0)
    bent = x + 8.0 * np.sin(y / 80.0), y + 8.0 * np.sin(x / 90.0)
    stripes = [np.sign(np.sin(2.0 * np.pi * (w.fx * bent[0] + w.fy * bent[1]))) for w in waves]
    threads = np.random.default_rng(2).standard_normal(x.shape)
    tone = torch.from_numpy((0.7 * sum(stripes) + 0.4 * threads).astype(np.float32))
    maps = replace(shot.maps, diffuse=0.1 * tone.exp().expand(3, -1, -1))
    shot = replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))
    found, _ = _transported(shot, _hidden(shot), HOLE, waves)
    assert _likeness(found, shot) > 0.7  # 0.57 by random blocks


def test_a_scratch_through_the_highlight_is_kept(shot: Photographed) -> None:
    """A scratch that continues through the highlight is kept."""
    albedo = shot.maps.diffuse.clone()
    albedo[:, 100:220, 250:262] *= 4.0
    maps = replace(shot.maps, diffuse=albedo)
    scratched = replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))
    exemplar = replace(_hidden(scratched), diffuse=albedo.clamp(0.0, 0.95).numpy())
    whole = _lent(scratched, exemplar)
    inside = (slice(None), slice(120, 200), slice(250, 262))
    assert whole.diffuse[inside].mean() == pytest.approx(exemplar.diffuse[inside].mean(), rel=0.05)


def test_contrast_that_the_own_maps_do_not_render_keeps_nothing(shot: Photographed) -> None:
    """Glints of relief that is estimated too flat are no scratch; maps of other places go there."""
    y, x = torch.meshgrid(torch.arange(384), torch.arange(512), indexing="ij")
    glints = (1.5 * torch.sin(x * 0.9) * torch.sin(y * 0.9)).exp()
    whole = _lent(replace(shot, linear=shot.linear * glints), _hidden(shot))
    found = np.log(whole.diffuse)[:, *HOLE].std()
    assert found == pytest.approx(float(shot.maps.diffuse.log()[:, *HOLE].std()), rel=0.3)


def test_a_unique_pattern_is_inpainted_too(shot: Photographed) -> None:
    """No two places of bumps are alike; glare over them must not stay a pale disc for that."""
    bumpy = photographed(0.1, 0.3)
    hole = np.log(_lent(bumpy, _hidden(bumpy)).diffuse)[:, 120:200, 210:300]
    truth = bumpy.maps.diffuse.log().numpy()
    assert hole.std((1, 2)).mean() == pytest.approx(truth.std((1, 2)).mean(), rel=0.3)


def test_a_clipped_hole_is_not_filled_with_what_is_plain(shot: Photographed) -> None:
    """A plain block fits any surroundings better than another part of an irregular drawing."""
    contrast = []
    for seed in (7, 8):
        rng = np.random.default_rng(seed)
        noise, where = (
            cv2.GaussianBlur(rng.standard_normal((384, 512)).astype(np.float32), (0, 0), width)
            for width in (2.0, 24.0)
        )
        drawn = torch.from_numpy(noise / noise.std() * (where > np.quantile(where, 0.4)))
        maps = replace(shot.maps, diffuse=0.2 * (0.4 * drawn).exp().expand(3, -1, -1))
        irregular = replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))
        found = np.log(_lent(irregular, _hidden(irregular), HOLE).diffuse[0])
        contrast.append(found[116:204, 196:314].std() / np.log(maps.diffuse[0].numpy()).std())
    assert np.mean(contrast) > 0.8


def test_inpainting_is_deterministic(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    first, again = (_lent(shot, exemplar) for _ in range(2))
    assert np.array_equal(first.stacked(), again.stacked())


def test_marks_are_not_copied_but_those_of_most_blocks_are(shot: Photographed) -> None:
    """Dirt, and a shadow along an edge, are not shown a second time."""
    rng = np.random.default_rng(3)
    marked = _hidden(shot)
    dusty, spotted = (marked.diffuse.copy() for _ in range(2))
    dusty[:, 377:] = 0.005
    for row, column in rng.integers((8, 8), (350, 500), size=(25, 2)):
        dusty[:, row : row + 5, column : column + 5] = 0.005
    for row, column in rng.integers((8, 8), (370, 500), size=(200, 2)):
        spotted[:, row : row + 5, column : column + 5] = 0.005
    for albedo, copied in ((dusty, False), (spotted, True)):
        albedo[:, *HOLE] = 0.8
        whole = _lent(shot, replace(marked, diffuse=albedo), HOLE)
        assert bool((whole.diffuse[:, *HOLE] < 0.02).any()) == copied


def _noise(shot: Photographed) -> np.ndarray:
    """Log albedo of an irregular texture of two tones."""
    noise = np.random.default_rng(5).standard_normal(shot.maps.height.shape[-2:])
    blurred = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 1.5)
    return 0.4 * np.tanh(3.0 * blurred / blurred.std())


def _drawn(shot: Photographed, log: np.ndarray) -> Photographed:
    """The photograph of an even material with this log albedo."""
    albedo = 0.1 * torch.from_numpy(log).float().exp().expand(3, -1, -1)
    maps = replace(shot.maps, diffuse=albedo)
    return replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))


def test_scratches_are_not_copied(shot: Photographed) -> None:
    """Scratches are not shown again, though the texture's own tones differ as much."""
    log = _noise(shot)
    lines = np.zeros(log.shape, np.uint8)
    for first in ((40, 20), (230, 222), (380, 230)):
        for by in range(0, 60, 20):
            cv2.line(lines, (first[0] + by, first[1]), (first[0] + by + 50, first[1] + 110), 1, 6)
    lines[HOLE] = 0
    scratched = _drawn(shot, np.where(lines, 0.8, log))
    _, copies = _transported(scratched, _hidden(scratched), HOLE)
    assert copies is not None
    # The borders of blocks may touch one.
    assert lines[copies.source[0], copies.source[1]][copies.copied].mean() < 0.01


def test_cloth_is_not_copied_to_where_it_is_combed_otherwise(shot: Photographed) -> None:
    """Threads run down at the left, and across and stronger at the right, as under a near flash."""
    rng, across = np.random.default_rng(6), np.linspace(0.0, 1.0, 512)
    down, along = (
        cv2.GaussianBlur(rng.standard_normal((384, 512)), (0, 0), x, sigmaY=y)
        for x, y in ((1.2, 5.0), (5.0, 1.2))
    )
    log = 0.2 * (1.0 - across) * down / down.std() + 0.5 * across * along / along.std()
    combed = _drawn(shot, log)
    _, copies = _transported(combed, _hidden(combed), HOLE)
    assert copies is not None
    away = np.abs(copies.source[1] - np.indices(copies.copied.shape)[1])[copies.copied]
    assert np.quantile(away, 0.9) < 60


def test_no_place_is_copied_twice(shot: Photographed) -> None:
    """With room for other places; the eye finds one next to itself."""
    drawn = _drawn(shot, _noise(shot))
    _, copies = _transported(drawn, _hidden(drawn), HOLE)
    assert copies is not None
    rows, columns = copies.source[:, copies.copied]
    times = np.bincount(rows * 512 + columns)
    assert times[times > 1].sum() < 0.1 * times.sum()


def test_confident_scattered_or_tiny_exemplars_are_not_inpainted(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    trusted = replace(exemplar, confidence=np.ones_like(exemplar.confidence))
    assert _lent(shot, trusted) is trusted
    specks = exemplar.confidence.copy()
    specks[:, ::4, ::4] = 0.0
    scattered = replace(exemplar, confidence=specks)
    assert _lent(shot, scattered) is scattered
    small = photographed(0.1, 0.5, width=40, height=30)
    diagonal = np.eye(30, 40, dtype=np.float32)[None].repeat(4, 0)
    tiny = replace(_certain(small), confidence=diagonal)
    assert _lent(small, tiny) is tiny


def test_a_coloured_specular_albedo_is_copied_as_the_field_reads_it(shot: Photographed) -> None:
    """The field's kernel takes planes of one block of memory each."""
    exemplar = _hidden(shot)
    coloured = replace(exemplar, specular=np.repeat(exemplar.specular, 3, axis=0))
    maps = _lent(shot, coloured)
    assert maps.specular.shape[0] == 3
    for name in ("diffuse", "specular", "roughness", "height"):
        assert getattr(maps, name).flags.c_contiguous, name


def test_a_wrong_slope_in_the_highlight_leaves_no_scratch(shot: Photographed) -> None:
    """An error of the fitted highlight, quadratic in place, neither keeps nor changes a drawing."""
    exemplar = _hidden(shot)
    y, x = torch.meshgrid(torch.linspace(-4, 4, 384), torch.linspace(-5, 5, 512), indexing="ij")
    brighter = replace(shot, linear=shot.linear * (0.3 * x + 0.2 * y - 0.1 * x * y).exp())
    assert _likeness(_lent(brighter, exemplar), shot) > 0.7


def test_blocks_leave_no_steps_in_roughness(shot: Photographed) -> None:
    """Roughness that varies slowly differs between the places that blocks are copied from."""
    across = np.linspace(0.3, 0.6, 512, dtype=np.float32)
    exemplar = _hidden(shot)
    exemplar = replace(exemplar, roughness=np.broadcast_to(across, exemplar.roughness.shape).copy())
    filled = _lent(shot, exemplar, HOLE).roughness[0]
    steps = max(np.abs(np.diff(filled, axis=axis)).max() for axis in (0, 1))
    assert np.abs(filled - exemplar.roughness[0]).max() > 0.01 and steps < 0.03


# Copied texels meet without steps, and keep what they draw.


SIZE = 64
FREE = np.zeros((SIZE, SIZE), bool)
FREE[24:40, 24:40] = True


def copied_from(rows, columns):
    """Every free texel is of the one so many rows and columns away."""
    source = np.indices((SIZE, SIZE))
    source[:, FREE] += np.array([rows, columns])[:, None]
    return source


def test_finer_maps_are_copied_from_the_same_places():
    fine = np.random.default_rng(9).standard_normal((2, 3 * SIZE, 2 * SIZE)).astype(np.float32)
    read = Copies(copied_from(-16, 8), FREE).read(fine)
    free = FREE.repeat(3, axis=0).repeat(2, axis=1)
    assert np.array_equal(read[:, free], np.roll(fine, (48, -16), axis=(1, 2))[:, free])
    assert np.array_equal(read[:, ~free], fine[:, ~free])


def test_a_copy_from_one_period_away_is_exact():
    """A period away all is the same."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    maps = np.stack([np.sin(2 * np.pi * x / 16), np.cos(2 * np.pi * (x + y) / 16)])
    torn = np.where(FREE, 9.0, maps)
    result = composed(torn.astype(np.float32), copied_from(-16, 0), FREE, 20.0)
    assert result == pytest.approx(maps, abs=1e-4)


def test_a_drift_between_source_and_target_leaves_no_step():
    drawn = np.random.default_rng(1).normal(0.0, 0.1, (1, SIZE, SIZE))
    maps = (drawn + np.linspace(0.0, 3.0, SIZE)[None, None]).astype(np.float32)
    source = copied_from(0, 20)
    plain = maps[:, source[0], source[1]]
    blended = composed(maps, source, FREE, 20.0)

    def step(picture):
        edge = np.abs(picture[0, 24:40, 24] - picture[0, 24:40, 23]).mean()
        return edge / np.abs(np.diff(maps[0], axis=1)).mean()

    assert step(plain) > 4.0 and step(blended) < 1.5
    inside = (0, slice(26, 38), slice(26, 38))
    kept = np.corrcoef(np.diff(plain[inside]).ravel(), np.diff(blended[inside]).ravel())[0, 1]
    assert kept > 0.98 and np.array_equal(blended[:, ~FREE], maps[:, ~FREE])


def test_far_from_a_seam_texels_are_those_of_the_source():
    """`reach` texels away most of a step is forgotten, and several of them away all of it."""
    maps = np.zeros((1, SIZE, SIZE), np.float32)
    maps[:, :, :8] = 1.0
    source = copied_from(0, 0)
    source[1][FREE] = 2
    assert composed(maps, source, FREE, 1.5)[0, 32, 32] == pytest.approx(1.0, abs=0.02)


def test_without_free_texels_the_input_is_returned():
    maps = np.ones((2, SIZE, SIZE), np.float32)
    assert composed(maps, copied_from(0, 0), np.zeros_like(FREE), 10.0) is maps
