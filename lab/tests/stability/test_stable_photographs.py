"""Photographs that go wrong end in finite maps or in one sentence that says why not."""

import numpy as np
import pytest
import torch
from arrays import photo_from_array
from stable.captures import capture_array, finite, within_ranges
from stable.photographs import HARD_PHOTOGRAPHS, textured

from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import read_plane, rectify
from matcap.space.tuning.match import cut_windows
from matcap.statistics.compare import FilterBank, FilterBankConfig, fit_encoding
from matcap.statistics.lattice import find_lattice

WIDTH, HEIGHT = 96, 72
REFUSED = {
    "black": "black",
    "white": "white",
    "gain 1e-6": "white is 1",
    "gain 1e6": "white",
    "one NaN": "NaN or infinite",
    "one infinity": "NaN or infinite",
    "a strip": "too few to hold a texture",
}
ENDS = [name for name in HARD_PHOTOGRAPHS if name not in REFUSED]
# Captured whole; the others go through all that looks at the photograph itself.
CAPTURED = [
    "grey", "one white dot on black", "checkerboard of pixels",
    "tilted by 50 degrees twice", "64 x 64",
]  # fmt: skip


def made(name, seed=1):
    return HARD_PHOTOGRAPHS[name](WIDTH, HEIGHT, seed)


def settings(**changed):
    return CaptureSettings(**{"detail": WIDTH, "generator": "example", **changed})


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_captured_is_refused_in_one_sentence(name):
    with pytest.raises(MatcapError, match=REFUSED[name]) as refused:
        capture_array(made(name), settings(), name)
    assert refused.value.remedy
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", CAPTURED)
def test_the_others_end_in_finite_maps(name):
    prior = "auto" if name in ("64 x 64", "grey") else "none"
    asked = settings(prior=prior, preset="instant", steps=2, aligned=True, generator="decoder")
    result = capture_array(made(name), asked, name)
    assert finite(result)
    assert within_ranges(result.estimate, seed=1)
    assert len(result.tuning.history) == 2
    maps = result.maps.stacked()
    assert maps[:5].min() >= 0 and maps[:5].max() <= 1


@pytest.mark.parametrize("name", ENDS)
def test_whatever_looks_at_a_photograph_gives_finite_numbers(name):
    photo = photo_from_array(made(name), long_side=WIDTH, fov=65.0, name=name)
    for tilt in ((0.0, 0.0), (0.9, -0.9)):
        plane = read_plane(photo, FlashSetup(fov=65.0, tilt=tilt), WIDTH)
        bank = FilterBank(FilterBankConfig(sizes=(3,), filters=4, levels=2))
        windows = cut_windows(plane, bank, 64)
        numbers = [plane.linear, plane.encoding.matrix, windows.target.mean, *windows.target.grams]
        numbers += [*windows.target.spectra, *windows.target.quantiles]
        assert all(bool(torch.isfinite(n).all()) for n in numbers)
    # Tiled to the least size that is looked at.
    colour = plane.encoded().repeat(1, 4, 3)[:, :256, :256]
    assert len(find_lattice(colour, plane.valid.repeat(4, 3)[:256, :256]).waves) <= 2


def test_half_the_exposure_gives_the_same_maps():
    """Texel by texel too, of the piece where it was seen: rounding may rearrange it otherwise.

    Neither clips: what does is known less of.
    """
    bright, dark = (
        capture_array(gain * textured(WIDTH, HEIGHT, 3), settings(), "exposed")
        for gain in (0.5, 0.25)
    )
    pieces = [result.estimate.exemplar for result in (bright, dark)]
    seen = torch.from_numpy(np.minimum(*(p.confidence[0] for p in pieces)) > 0.0)
    seen = -torch.nn.functional.max_pool2d(-seen[None].float(), 41, 1, 20)[0] > 0.0
    assert seen.float().mean() > 0.2
    one, other = (torch.from_numpy(p.stacked())[:, seen] for p in pieces)
    assert torch.allclose(one[:5].mean(1), other[:5].mean(1), rtol=0.01)
    # F0 and roughness are one number each: a class's.
    assert torch.allclose(one.std(1), other.std(1), rtol=0.05, atol=1e-6)
    apart = (one - other).square().mean(1).sqrt()
    half = torch.finfo(torch.float16).eps * one.abs().amax(1)  # maps are kept in half precision
    assert bool((apart <= 0.3 * one.std(1) + half).all())
    intensities = [r.material.setup.intensity[0] for r in (bright, dark)]
    assert intensities[1] / intensities[0] == pytest.approx(0.5, rel=0.02)


def test_half_the_size_gives_the_same_statistics():
    """Both are looked at in the same detail; the small one is the large one, averaged."""
    large = textured(4 * WIDTH, 4 * HEIGHT, 3)
    small = large.reshape(2 * HEIGHT, 2, 2 * WIDTH, 2, 3).mean((1, 3))
    fits, encodings = [], []
    for pixels in (large, small):
        photo = photo_from_array(pixels, fov=65.0, radiometric=True)
        fits.append(fit_coarse(photo))
        encodings.append(fit_encoding(*rectify(photo, FlashSetup(fov=65.0), WIDTH)))
    assert fits[0].diffuse == pytest.approx(fits[1].diffuse, rel=0.02)
    assert fits[0].roughness == pytest.approx(fits[1].roughness, abs=0.01)
    assert encodings[0].median == pytest.approx(encodings[1].median, rel=0.01)
    covariances = [torch.linalg.inv(e.matrix.T @ e.matrix) for e in encodings]
    assert torch.allclose(*covariances, rtol=0.05, atol=1e-3 * float(covariances[0].max()))


def test_turned_by_a_right_angle_the_material_stays_and_the_flash_turns():
    square = textured(WIDTH, WIDTH, 3)
    fits = [
        fit_coarse(photo_from_array(np.rot90(square, k).copy(), fov=65.0, radiometric=True))
        for k in (0, 1)
    ]
    assert fits[0].diffuse == pytest.approx(fits[1].diffuse, rel=0.02)
    assert fits[0].roughness == pytest.approx(fits[1].roughness, abs=0.01)
    (x, y, _), turned = (fit.setup.offset for fit in fits)
    assert turned[:2] == pytest.approx((-y, x), abs=0.01)
