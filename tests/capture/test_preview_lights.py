"""Panels under other lights render some texels of large maps, and the crop at full resolution."""

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture import preview
from matcap.flash.geometry import FlashSetup


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
