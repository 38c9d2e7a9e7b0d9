"""A cut shows; what continues does not."""

import numpy as np

from matcap.lab.bench.fields import seam_contrast

TEXEL = 0.002


def waves(height=400, width=600):
    """(6, H, W) maps of slow noise, about sixteen texels."""
    noise = np.random.default_rng(4).standard_normal((6, height, width))
    turns = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((30.0 * turns) ** 2))).real
    smooth /= smooth.std(axis=(1, 2), keepdims=True)
    maps = 0.3 * np.exp(0.2 * smooth)
    maps[5] = 0.01 * smooth[5]
    return maps.astype(np.float32)


def split(shift):
    """Places of a field whose right half lies elsewhere by a shift (x, y) of texels."""
    places = np.stack(np.meshgrid(np.arange(200), np.arange(300)), axis=-1)
    places[:, 100:] += shift
    return places


def measured(maps, places, shown=None):
    shown = maps[:, places[..., 1], places[..., 0]] if shown is None else shown
    return seam_contrast(shown, places, maps, TEXEL)


def test_what_was_not_rearranged_has_no_seams():
    assert np.isnan(list(measured(waves(), split((0, 0))).values())).all()


def test_a_cut_shows_in_albedo_and_slope():
    found = measured(waves(), split((317, 60)))
    assert found["seam albedo"] > 5.0 and found["seam slope"] > 5.0
    assert found["seam albedo 99 %"] > 3.0


def test_a_seam_that_what_it_shows_hides_measures_one():
    """Of a piece that repeats: another place, and the same texels."""
    maps = np.tile(waves(400, 300), (1, 1, 2))
    found = measured(maps, split((300, 0)))
    for name in ("seam albedo", "seam slope"):
        assert 0.8 < found[name] < 1.25 and 0.7 < found[f"{name} 99 %"] < 1.3


def test_colour_alone_shows_in_albedo_alone():
    maps = np.tile(waves(400, 300), (1, 1, 2))
    places = split((300, 0))
    shown = maps[:, places[..., 1], places[..., 0]].copy()
    shown[0, :, 100:] *= 1.5
    found = measured(maps, places, shown)
    assert found["seam albedo"] > 5.0 and 0.8 < found["seam slope"] < 1.25
