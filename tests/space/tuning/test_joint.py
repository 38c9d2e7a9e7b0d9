"""Several photographs of one sample: every window is lit as in its own photograph."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.render import render_flash
from matcap.space.tuning.likeness import PhotographTarget, render_windows
from matcap.space.tuning.windows import Windows

SETUPS = (
    FlashSetup(offset=(0.1, 0.0, 0.0), tilt=(0.1, 0.0), intensity=(5.0, 5.0, 5.0)),
    FlashSetup(offset=(0.0, -0.1, 0.0), tilt=(0.0, -0.1), intensity=(3.0, 4.0, 5.0)),
)


def test_each_window_is_rendered_as_in_its_own_photograph():
    maps = MapSet.from_stacked(torch.rand(1, 6, 16, 16) * 0.5 + 0.1, 2.0 / 64)
    points = plane_points(8, 4, 16, 16, (64, 48), dtype=torch.float32)[None].repeat(3, 1, 1, 1)
    windows = Windows(16, points, None, photographs=torch.tensor([1, 0, 0]))
    scene = PhotographTarget(windows, SETUPS[0], None, None, (), 2.0 / 64, others=SETUPS[1:])
    found = render_windows(maps, scene, torch.tensor([0, 2]), step=1)
    expected = torch.cat([render_flash(maps, SETUPS[number], points[:1]) for number in (1, 0)])
    torch.testing.assert_close(found, expected)
    assert not torch.equal(found[0], found[1])


def test_each_photograph_keeps_its_own_geometry_and_gain():
    camera = PhoneCamera(width=128, height=96, supersampling=1)
    material = piece("leather", 4)
    first, second = (
        as_photo(take(material, camera, setup), 1, f"{index}.dng")
        for index, setup in enumerate(SETUPS)
    )
    darker = replace(second, pixels=second.pixels * 0.5)
    settings = CaptureSettings(steps=2, detail=128, prior="none", generator="decoder")
    result = capture_photo(first, settings, others=[second, darker])
    assert type(result.material.setup) is FlashSetup
    others = result.material.provenance["others"]
    assert [other["photograph"] for other in others] == ["1.dng", "1.dng"]
    assert others[0]["tilt_degrees"] == pytest.approx([0.0, math.degrees(-0.1)], abs=3.0)
    assert others[1]["gain"] / others[0]["gain"] == pytest.approx(2.0, rel=0.05)
