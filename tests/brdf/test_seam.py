"""The measure of seams, on maps whose seams are known."""

import pytest
import torch
import torch.nn.functional as F

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import MapSet
from matcap.brdf.seam import seam_ratio

SEAMLESS = 1.15  # invisible: single lines of a texture scatter by as much


def smooth(*, circular: bool) -> MapSet:
    """Blotches eight texels wide that wrap around, or do not."""
    noise = torch.rand(1, 6, 128, 128, generator=torch.Generator().manual_seed(1))
    mode = "circular" if circular else "reflect"
    for _ in range(2):
        noise = F.avg_pool2d(F.pad(noise, (4, 4, 4, 4), mode=mode), 9, 1)
    return MapSet.from_stacked(noise[0], 0.01, periodic=circular)


def test_maps_that_wrap_have_no_seam_and_others_have():
    assert seam_ratio(smooth(circular=True)) <= SEAMLESS
    assert seam_ratio(smooth(circular=False)) > 2.0


def test_the_worse_axis_counts():
    maps = smooth(circular=True)
    assert seam_ratio(maps.crop(0, 0, 100, 128)) > 2.0 < seam_ratio(maps.crop(0, 0, 128, 100))


def test_maps_that_hold_nothing_have_no_seam():
    assert seam_ratio(MapSet.from_stacked(torch.full((6, 16, 16), 0.5), 0.1)) == pytest.approx(1.0)
    assert seam_ratio(MapSet.from_stacked(torch.zeros(6, 2, 2), 0.1)) == 1.0


@pytest.mark.parametrize("circular", [True, False])
def test_a_map_set_says_what_was_measured(tmp_path, circular):
    maps = smooth(circular=circular)
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    document = read_mapset(tmp_path)[1]
    assert document["periodic"] is circular
    assert document["seam"] == pytest.approx(seam_ratio(maps), abs=1e-3)
