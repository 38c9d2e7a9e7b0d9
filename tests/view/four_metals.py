"""Metals of which each has an F0 of its own: what a page is compared with relight by."""

import numpy as np
import torch

from matcap.brdf.maps import MapSet

STEEL = (0.56, 0.57, 0.58)
# Base colours, linear Rec.709.
METALS = {
    "gold": (1.0, 0.77, 0.34),
    "copper": (0.95, 0.64, 0.54),
    "blue anodised": (0.05, 0.16, 0.5),
    "rust beside steel": STEEL,
}
RUST = (0.22, 0.07, 0.03)  # diffuse; it mirrors as what is no metal does
DIELECTRIC = 0.04


def metal(name, width=320, height=240, seed=5) -> MapSet:
    """(height, width) texels of one of METALS, which repeat: bumps of some ten texels, gloss that
    varies; and rust in patches, on steel alone.
    """
    waves = np.stack([_waves(width, height, seed + k) for k in range(3)])
    patches = np.clip(0.5 + 2.0 * waves[0], 0.0, 1.0)
    metalness = patches if name == "rust beside steel" else np.ones_like(patches)
    base = np.asarray(METALS[name])[:, None, None]
    rust = np.asarray(RUST)[:, None, None]
    stacked = np.concatenate([
        rust * (1.0 - metalness),
        DIELECTRIC * (1.0 - metalness) + base * metalness,
        (0.35 + 0.1 * waves[1] + 0.4 * (1.0 - metalness))[None].clip(0.1, 1.0),
        0.003 * waves[2][None],
    ])  # fmt: skip
    maps = torch.from_numpy(stacked.astype(np.float32))
    return MapSet.from_stacked(maps, 2 / 1024, periodic=True)


def side_by_side() -> MapSet:
    """(240, 320) texels: a stripe of 80 of each of METALS."""
    return MapSet.from_stacked(
        torch.cat([metal(name, 80).stacked() for name in METALS], dim=-1), 2 / 1024, periodic=True
    )


def repeated(maps, times=4) -> MapSet:
    """The maps so often beside and below themselves."""
    return maps.map(lambda one: one.repeat(1, times, times))


def _waves(width, height, seed):
    """(height, width) of deviation 1, seamless, of no grain finer than some ten texels."""
    noise = np.random.default_rng(seed).standard_normal((height, width))
    y, x = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((np.hypot(x, y) * 12.0) ** 2))).real
    return smooth / smooth.std()
