"""Windows cover the picture and keep their place."""

import pytest
import torch

from matcap.flash.geometry import plane_points
from matcap.flash.plane import plane_of
from matcap.space.tuning.windows import _best_scale, cut_windows
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

BANK = FilterBank(FilterBankConfig(sizes=(3,), filters=4, levels=2))
WIDTH, HEIGHT, SIZE = 96, 64, 32


def cut(valid=None, *, size=SIZE, width=WIDTH, height=HEIGHT):
    """A picture whose brightness tells where it was cut, and its windows."""
    generator = torch.Generator().manual_seed(0)
    slope = torch.linspace(0.1, 0.9, width) * torch.linspace(0.5, 1.0, height)[:, None]
    linear = slope * torch.exp(0.1 * torch.randn(3, height, width, generator=generator))
    valid = torch.ones(height, width, dtype=torch.bool) if valid is None else valid
    plane = plane_of(linear, valid)
    return linear, plane.encoding, cut_windows(plane, BANK, size)


def corners(windows, width=WIDTH, height=HEIGHT):
    """(column, row) of every window's left top texel, from its plane points."""
    first = windows.points[:, :2, 0, 0]
    column = (first[:, 0] + 1.0) * width / 2.0 - 0.5
    row = height / 2.0 - first[:, 1] * width / 2.0 - 0.5
    return [(round(x), round(y)) for x, y in zip(column.tolist(), row.tolist(), strict=True)]


def test_every_window_has_the_points_and_the_picture_of_its_own_place():
    linear, encoding, windows = cut()
    for index, (x, y) in enumerate(corners(windows)):
        expected = plane_points(x, y, SIZE, SIZE, (WIDTH, HEIGHT), dtype=torch.float32)
        assert torch.allclose(windows.points[index], expected, atol=1e-6)
        here = describe(linear[None, :, y : y + SIZE, x : x + SIZE], encoding, BANK)
        target = windows.target.select([index])
        assert torch.equal(target.mean, here.mean)
        unraised = Weights(gram=0.0, cross=0.0, histogram=0.0)
        assert float(distance(target, here, unraised)) < 1e-5
        for kind in ("grams", "crosses", "quantiles"):
            for raised, plain in zip(getattr(target, kind), getattr(here, kind), strict=True):
                scale = float((raised * plain).sum() / plain.square().sum())
                assert 1.0 <= scale <= 1.0 / 0.7 + 1e-6
                torch.testing.assert_close(raised, scale * plain, atol=1e-5, rtol=1e-4)


def test_the_best_scale_is_where_the_distance_is_least():
    generator = torch.Generator().manual_seed(2)
    found, target = ((0.5 * torch.randn(6, 5, 5, generator=generator)).exp() for _ in range(2))
    found[0, 0, 0] = 0.0
    size = target.abs().flatten(1).mean(dim=1)

    def cost(scale):
        return float(((scale * found - target).abs().flatten(1).mean(dim=1) / size).mean())

    best = _best_scale(found, target)
    assert 0.7 <= best <= 1.0
    assert cost(best) <= min(cost(best * other) for other in (0.97, 0.99, 1.01, 1.03)) + 1e-6


def test_raised_targets_lead_to_the_true_contrast():
    """Draws as scattered as the photograph's windows are nearest to them at their own size."""
    generator = torch.Generator().manual_seed(4)
    draws = (0.5 * torch.randn(400, 40, 40, generator=generator)).exp()
    first, second = torch.arange(0, 200), torch.arange(200, 400)
    raised = draws[second] / _best_scale(draws[first], draws[second])
    assert _best_scale(draws[first], draws[second]) < 0.9
    assert _best_scale(draws[first], raised) == pytest.approx(1.0, abs=0.01)


def test_a_picture_without_neighbours_is_left_as_it_is():
    linear, encoding, windows = cut(width=32, height=32)
    here = describe(linear[None], encoding, BANK)
    assert float(distance(windows.target, here, Weights())) < 1e-5


@pytest.mark.parametrize(("width", "height"), [(96, 64), (97, 33), (32, 32), (200, 40)])
def test_together_they_cover_the_picture_and_none_reaches_outside(width, height):
    _, _, windows = cut(width=width, height=height)
    seen = torch.zeros(height, width, dtype=torch.bool)
    for x, y in corners(windows, width, height):
        assert 0 <= x <= width - SIZE and 0 <= y <= height - SIZE
        seen[y : y + SIZE, x : x + SIZE] = True
    assert bool(seen.all())
    assert len(set(corners(windows, width, height))) == windows.count


def test_windows_hardly_seen_are_left_out():
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    valid[:, 48:] = False
    _, _, windows = cut(valid)
    assert 0 < windows.count < cut()[2].count
    for x, y in corners(windows):
        assert valid[y : y + SIZE, x : x + SIZE].float().mean() >= 0.3


def test_where_nothing_was_seen_all_windows_stay():
    _, _, windows = cut(torch.zeros(HEIGHT, WIDTH, dtype=torch.bool))
    assert windows.count == cut()[2].count
