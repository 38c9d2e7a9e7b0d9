"""Shares of a mask in closed form, and what is seen where two materials meet."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from PIL import Image

from matcap.field.plane import Rectangle, Span
from matcap.synth.blend import BlendSource
from matcap.synth.mask import Mask, read_mask


def shares(pixels, over, x=0, y=0, size=(1, 1), period=None):
    mask = Mask(np.array(pixels, np.uint8), Rectangle(*over), period)
    return mask.shares(x, y, Span(0, size[1]), Span(0, size[0])).numpy()


def test_between_pixels_it_is_bilinear_and_beyond_the_border_goes_on():
    """Two pixels over eight texels: their centres lie at texels 1.5 and 5.5."""
    found = shares([[0, 255], [255, 255]], (0, 0, 8, 8), x=-2, y=-2, size=(12, 12))
    ramp = np.clip((np.arange(-2, 10) + 0.5 - 2.0) / 4.0, 0.0, 1.0)
    expected = 1.0 - (1.0 - ramp)[:, None] * (1.0 - ramp)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_its_first_row_is_the_top():
    found = shares([[255, 255], [0, 0]], (0, 0, 4, 4), size=(4, 4))
    assert found[0].min() == 1.0 and found[3].max() == 0.0


def test_where_it_repeats_its_border_joins_the_other_one():
    found = shares([[0, 128, 255, 128]], (0, 0, 8, 8), size=(24, 1), period=(8, 8))[0]
    np.testing.assert_array_equal(found[:8], found[8:16])
    assert np.abs(np.diff(found)).max() <= 0.26
    # 128 at the last pixel and 0 at the first: half way between them a quarter.
    assert found[7] == pytest.approx(0.75 * 128 / 255, abs=1e-6)


@dataclass(frozen=True)
class Even:
    """A material of one albedo and height."""

    albedo: float
    height: float
    specular_channels: int = 1

    def maps(self, block):
        stacked = torch.full((6, block.height + 2, block.width + 2), self.albedo)
        stacked[5] = self.height
        return stacked


def mixed(share, first=0.0, second=0.0, means=(1.0, 3.0), deviation=0.1):
    """Albedo and height where materials stand so high above their means; white is the second."""
    pixels = np.full((1, 1), round(65535 * share), np.uint16)
    source = BlendSource(
        Even(0.0, means[0] + first), Even(1.0, means[1] + second), means, deviation,
        Mask(pixels, Rectangle(0, 0, 4, 4)),
    )  # fmt: skip
    maps = source.maps(Rectangle(0, 0, 2, 2))
    return float(maps[0, 1, 1]), float(maps[5, 1, 1])


def test_at_its_ends_each_material_is_alone():
    assert mixed(0.0) == (0.0, 1.0)
    assert mixed(1.0) == (1.0, 3.0)
    # Also where a peak of the other would reach through.
    assert mixed(0.03, second=0.5)[0] <= 8.0 * 0.03 + 1e-3


def test_the_second_rises_through_the_first_as_the_mask_turns_white():
    albedo = [mixed(share)[0] for share in (0.2, 0.4, 0.5, 0.6, 0.8)]
    assert albedo == sorted(albedo) and albedo[0] < 0.01 and albedo[-1] > 0.99
    assert albedo[2] == pytest.approx(0.5, abs=0.01)


def test_half_way_one_sees_whichever_is_higher_for_its_material():
    assert mixed(0.5, first=0.1, second=-0.1)[0] < 0.01
    assert mixed(0.5, first=-0.1, second=0.1)[0] > 0.99


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_the_level_goes_from_one_mean_to_the_other(share):
    """And what has risen is taken back, but for a part of the deviation."""
    _, height = mixed(share)
    assert height == pytest.approx(1.0 + 2.0 * share, abs=0.03)


def test_a_mask_in_alpha_is_the_same_as_in_grey(tmp_path):
    codes = np.arange(0, 240, 10, dtype=np.uint8).reshape(4, 6)
    Image.fromarray(codes).save(tmp_path / "grey.png")
    layer = np.concatenate([np.full((4, 6, 3), 255, np.uint8), codes[..., None]], axis=-1)
    Image.fromarray(layer).save(tmp_path / "alpha.png")
    over, area = Rectangle(0, 0, 12, 8), (Span(0, 8), Span(0, 12))
    grey, alpha = (
        read_mask(tmp_path / f"{name}.png", over).shares(0, 0, *area) for name in ("grey", "alpha")
    )
    plain = Mask(codes, over).shares(0, 0, *area)
    torch.testing.assert_close(grey, plain, rtol=0.0, atol=1e-6)
    torch.testing.assert_close(alpha, plain, rtol=0.0, atol=1e-6)
