"""Coarse textures are captured with half the texels; previews render some of large maps."""

import cv2
import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.capture import preview, rectified
from matcap.capture.rectified import coarse_share, lattice_of, network_input
from matcap.capture.settings import DETAIL
from matcap.flash.geometry import FlashSetup
from matcap.flash.plane import plane_of
from matcap.statistics.lattice import Lattice, Wave

HEIGHT = 768


def noise(scale, contrast=0.3, seed=0):
    """(3, H, W) grey light whose log varies over about so many texels."""
    white = np.random.default_rng(seed).standard_normal((HEIGHT, DETAIL)).astype(np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), scale)
    light = 0.2 * np.exp(contrast * smooth / smooth.std())
    return torch.from_numpy(light).expand(3, -1, -1)


SEEN = torch.ones(HEIGHT, DETAIL, dtype=torch.bool)


@pytest.mark.parametrize(
    ("scale", "detail"), [(1, 1024), (3, 1024), (4, 1024), (20, 512), (30, 512)]
)
def test_blotches_too_large_for_the_network_halve_the_detail(scale, detail):
    assert network_input(plane_of(noise(scale), SEEN)).size[0] == detail


def test_the_share_grows_with_the_size_and_neither_with_contrast_nor_exposure():
    shares = [coarse_share(noise(scale), SEEN) for scale in (2, 5, 10, 20)]
    assert shares == sorted(shares) and 0.0 <= shares[0] < shares[-1] <= 1.0
    strong = coarse_share(7.0 * noise(10, contrast=0.6), SEEN)
    assert strong == pytest.approx(shares[2], abs=0.02)


def test_the_flash_alone_is_not_a_coarse_texture():
    """Shading and highlight are far wider than what is counted."""
    x, y = torch.meshgrid(
        torch.linspace(-1, 1, DETAIL), torch.linspace(-0.75, 0.75, HEIGHT), indexing="xy"
    )
    squared = x.square() + y.square()
    lit = noise(2) * (1.2**2 / (1.2**2 + squared)) ** 2 + 0.3 * torch.exp(-squared / 0.08)
    assert network_input(plane_of(lit, SEEN)).size[0] == DETAIL


@pytest.mark.parametrize(("share", "period"), [(0.7, 88.0), (0.4, 173.0)])
def test_a_lattice_of_half_the_picture_is_used_if_most_lies_on_it(monkeypatch, share, period):
    """As of gingham 0264_0869, of which the whole picture shows 173 texels for 88."""
    found = {DETAIL: Lattice((Wave(0.0, 1 / 173),), 0.1), 512: Lattice((Wave(0.0, 1 / 44),), share)}
    monkeypatch.setattr(rectified, "find_lattice", lambda colour, _valid: found[colour.shape[2]])
    (wave,) = lattice_of(plane_of(noise(2), SEEN, None))
    assert wave == pytest.approx((0.0, 1 / period))


def test_what_was_not_seen_does_not_count():
    picture, seen = noise(2).clone(), SEEN.clone()
    picture[:, 200:500, 300:700] = 30.0
    seen[200:500, 300:700] = False
    assert coarse_share(picture, seen) == pytest.approx(coarse_share(noise(2), SEEN), abs=0.02)
    assert coarse_share(picture, torch.zeros_like(seen)) == 0.0
    assert coarse_share(torch.full((3, HEIGHT, DETAIL), 0.2), SEEN) == 0.0


def test_a_large_panel_looks_like_all_its_texels(monkeypatch):
    torch.manual_seed(0)
    one = torch.ones(1, 320, 640)
    bumps = torch.nn.functional.interpolate(
        torch.rand(1, 1, 40, 80), size=(320, 640), mode="bicubic"
    )
    maps = MapSet(one.expand(3, -1, -1) * 0.3, 0.04 * one, 0.5 * one, 0.01 * bumps[0], 2 / 640)
    panels = []
    for texels in (160, 640):
        monkeypatch.setattr(preview, "_LIT", texels)
        panels.append(preview.relit("left", maps, np.ones((2, 2, 3), np.float32), FlashSetup()))
    some, every = panels
    assert some.values.shape == (80, 160, 3) and every.values.shape == (320, 640, 3)
    codes = [np.asarray(panel.resized((32, 16)), float) for panel in panels]
    assert np.abs(codes[0] - codes[1]).mean() < 2.0 < codes[1].std()
    crops = [np.asarray(panel.crop(), float) for panel in panels]
    assert np.abs(crops[0] - crops[1]).max() <= 2.0
