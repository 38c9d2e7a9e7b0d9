"""What glare hides is lent by places that look like it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from photographed import SETUP, Photographed, photographed

from matcap.capture.exemplar.inpaint import transport
from matcap.example.exemplar import Exemplar
from matcap.flash.render import render_flash

HOLE = (slice(100, 220), slice(180, 330))


def _hidden(shot: Photographed, confidence: float = 1e-3) -> Exemplar:
    """Maps whose albedo is told nothing of inside the hole: flat and pale there."""
    maps = shot.maps
    trusted = np.ones((4, *maps.height.shape[-2:]), np.float32)
    trusted[:, *HOLE] = confidence
    albedo = maps.diffuse.clamp(0.0, 0.95).numpy().copy()
    albedo[:, *HOLE] = 0.8
    return Exemplar(
        albedo, maps.specular.numpy(), maps.roughness.numpy(), maps.height.numpy(), trusted,
        maps.texel_size,
    )  # fmt: skip


def _lent(shot: Photographed, exemplar: Exemplar, hole: tuple[slice, ...] = ()) -> Exemplar:
    """Inpainted; the photograph is clipped in a hole, if any."""
    valid = torch.ones(shot.linear.shape[1:], dtype=torch.bool)
    if hole:
        valid[hole] = False
    return transport(exemplar, shot.linear, valid, torch.ones_like(valid), shot.light)


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


def test_a_hole_looks_like_the_rest(shot: Photographed) -> None:
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


def test_what_is_far_from_the_hole_is_untouched(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    whole = _lent(shot, exemplar)
    for name in ("diffuse", "specular", "roughness", "height"):
        before, after = getattr(exemplar, name), getattr(whole, name)
        assert np.array_equal(before[:, :70], after[:, :70]), name


def test_the_drawing_is_what_the_photograph_shows_there(
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


def test_what_nothing_looks_like_stays(shot: Photographed) -> None:
    """A scratch that continues through the highlight is kept."""
    albedo = shot.maps.diffuse.clone()
    albedo[:, 100:220, 250:262] *= 4.0
    maps = replace(shot.maps, diffuse=albedo)
    scratched = replace(shot, maps=maps, linear=render_flash(maps, SETUP, shot.points))
    exemplar = replace(_hidden(scratched), diffuse=albedo.clamp(0.0, 0.95).numpy())
    whole = _lent(scratched, exemplar)
    inside = (slice(None), slice(120, 200), slice(250, 262))
    assert whole.diffuse[inside].mean() == pytest.approx(exemplar.diffuse[inside].mean(), rel=0.05)


def test_a_drawing_that_never_comes_again_is_lent_all_the_same(shot: Photographed) -> None:
    """No two places of bumps are alike; glare over them must not stay a pale disc for that."""
    bumpy = photographed(0.1, 0.3)
    exemplar = _hidden(bumpy)
    hole = np.log(_lent(bumpy, exemplar).diffuse)[:, 120:200, 210:300]
    truth = bumpy.maps.diffuse.log().numpy()
    assert hole.std((1, 2)).mean() == pytest.approx(truth.std((1, 2)).mean(), rel=0.3)


def test_it_is_the_same_every_time(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    first, again = (_lent(shot, exemplar) for _ in range(2))
    assert np.array_equal(first.stacked(), again.stacked())


def test_nothing_is_lent_where_nothing_hides_or_nobody_can(shot: Photographed) -> None:
    exemplar = _hidden(shot)
    trusted = replace(exemplar, confidence=np.ones_like(exemplar.confidence))
    assert _lent(shot, trusted) is trusted
    specks = exemplar.confidence.copy()
    specks[:, ::4, ::4] = 0.0
    scattered = replace(exemplar, confidence=specks)
    assert _lent(shot, scattered) is scattered
    small = photographed(0.1, 0.5, width=40, height=30)
    tiny = Exemplar(
        small.maps.diffuse.clamp(0.0, 0.95).numpy(), small.maps.specular.numpy(),
        small.maps.roughness.numpy(), small.maps.height.numpy(),
        np.eye(30, 40, dtype=np.float32)[None].repeat(4, 0), small.maps.texel_size,
    )  # fmt: skip
    assert _lent(small, tiny) is tiny


def test_a_coloured_specular_albedo_is_copied_as_the_field_reads_it(shot: Photographed) -> None:
    """The field's kernel takes planes of one block of memory each."""
    exemplar = _hidden(shot)
    coloured = replace(exemplar, specular=np.repeat(exemplar.specular, 3, axis=0))
    maps = _lent(shot, coloured)
    assert maps.specular.shape[0] == 3
    for name in ("diffuse", "specular", "roughness", "height"):
        assert getattr(maps, name).flags.c_contiguous, name


def test_a_wrong_slope_of_the_highlight_is_no_scratch(shot: Photographed) -> None:
    """An error of the fitted highlight, quadratic in place, neither keeps nor changes a drawing."""
    exemplar = _hidden(shot)
    y, x = torch.meshgrid(torch.linspace(-4, 4, 384), torch.linspace(-5, 5, 512), indexing="ij")
    brighter = replace(shot, linear=shot.linear * (0.3 * x + 0.2 * y - 0.1 * x * y).exp())
    assert _likeness(_lent(brighter, exemplar), shot) > 0.7
