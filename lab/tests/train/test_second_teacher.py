"""The second teacher: true maps of simulated materials, and what light from the side tells."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import fit_coarse
from matcap.space.prior.encoder_input import FEATURES
from matcap.statistics.encoding import Encoding
from matcap.statistics.filterbank import FilterBank
from matcap_lab.train.corpus import simulate, true_piece
from matcap_lab.train.step import (
    TrainConfig,
    Turn,
    comb,
    cut,
    prepare,
    relief_distance,
    relit_distance,
    side_light,
)
from matcap_lab.train.training import train

ENCODING = Encoding(0.2, 3.0 * torch.eye(3))


@pytest.fixture(scope="module")
def entry():
    return simulate(3)


def bumps(seed: int, height: float) -> MapSet:
    generator = torch.Generator().manual_seed(seed)
    noise = F.avg_pool2d(torch.randn(1, 1, 164, 164, generator=generator), 5, 1)
    grey = torch.full((1, 1, 160, 160), 0.3)
    texel = 2.0 / 1024
    return MapSet(grey.expand(1, 3, -1, -1), 0.1 * grey, 2.0 * grey, height * texel * noise, texel)


def apart(found: MapSet, truth: MapSet, seed: int = 0) -> float:
    light = side_light(np.random.default_rng(seed))
    return float(relit_distance(found, truth, light, ENCODING, FilterBank(FEATURES)))


def test_a_side_light_is_far_and_slanting():
    lights = torch.stack([side_light(np.random.default_rng(seed)) for seed in range(200)])
    angle = torch.rad2deg(torch.acos(lights[:, 2] / lights.norm(dim=1)))
    assert 29.9 < float(angle.min()) < 35.0 and 65.0 < float(angle.max()) < 70.1
    assert float((lights[:, :2] / lights[:, :2].norm(dim=1, keepdim=True)).mean(0).norm()) < 0.2


def test_truth_is_nearest_and_flatness_far():
    truth = bumps(1, 4.0)
    assert apart(truth, truth) == 0.0
    other, flat, deep = (apart(bumps(2, h), truth) for h in (4.0, 0.0, 16.0))
    assert other < 0.6 * flat and other < 0.3 * deep


def test_how_bright_a_surface_is_is_not_asked_for():
    truth = bumps(1, 4.0)
    darker = replace(truth, diffuse=truth.diffuse / 4.0, specular=truth.specular / 4.0)
    assert apart(darker, truth) < 0.15 * apart(bumps(1, 0.0), truth)


def test_relief_is_compared_octave_by_octave():
    truth = bumps(1, 4.0)
    assert float(relief_distance(truth, truth)) == 0.0
    assert float(relief_distance(bumps(2, 4.0), truth)) < 0.2
    doubled = float(relief_distance(bumps(1, 8.0), truth))
    assert 0.9 < doubled / (2.0 * np.log(2.0)) < 1.0  # unseen slopes count as equal
    fine = bumps(1, 0.0)
    noise = torch.randn(fine.height.shape, generator=torch.Generator().manual_seed(3))
    squared = (truth.height / truth.texel_size).diff(dim=-1).square().mean()
    rough = replace(fine, height=(squared / 2.0).sqrt() * fine.texel_size * noise)
    assert float(relief_distance(rough, truth)) > 0.4  # as steep at its finest, not beyond


def test_a_comb_is_seen_though_no_normal_shows_it():
    truth = bumps(1, 4.0)
    assert float(comb(truth)) == 0.0  # five texels wide
    columns = torch.arange(truth.height.shape[-1]) % 2
    combed = replace(truth, height=truth.height + 2.0 * truth.texel_size * columns)
    assert float((combed.normal - truth.normal).abs()[..., 1:-1].max()) < 1e-5
    assert float(comb(combed)) > 0.8
    assert float(relief_distance(combed, truth)) > 0.2


def test_relief_is_told_which_way_to_go():
    truth, height = bumps(1, 4.0), torch.tensor(1.0, requires_grad=True)
    plain = bumps(2, 1.0)
    found = replace(plain, height=plain.height * height)
    light = side_light(np.random.default_rng(0))
    relit_distance(found, truth, light, ENCODING, FilterBank(FEATURES)).backward()
    assert height.grad is not None and float(height.grad) < 0.0


def test_a_simulated_photographs_maps_are_of_what_it_shows(entry):
    """The hue of their mean albedo is what a fit under the simulated white flash finds."""
    maps = true_piece(entry, 512)
    assert maps is not None and maps.size == (512, 512)
    mean = maps.diffuse.double().mean((1, 2))
    white = fit_coarse(replace(entry.photo(), flash_intensity=1.0))
    assert torch.allclose(mean / mean.sum(), hue(white.diffuse), atol=0.03)


def hue(diffuse) -> torch.Tensor:
    colour = torch.tensor(diffuse, dtype=torch.float64)
    return colour / colour.sum()


def test_real_photographs_have_no_truth_and_strange_ones_are_refused(pack, entry):
    assert true_piece(pack.entries[0], 64) is None
    for strange in (replace(entry, tilt=(0.2, 0.1)), replace(entry, name="simulated_x")):
        with pytest.raises(MatcapError, match="another version") as error:
            true_piece(strange, 64)
        assert error.value.where == strange.name


@pytest.mark.parametrize("quarters", range(4))
def test_true_windows_turn_with_the_photographs(entry, quarters):
    source = prepare(entry, 64, true_piece(entry, 128))
    turn = Turn(True, quarters)
    plain = cut(source, 64, 1, 2, Turn(), np.random.default_rng(1), augment=False).truth
    turned = cut(source, 64, 1, 2, turn, np.random.default_rng(1), augment=False).truth
    assert plain is not None and turned is not None
    assert torch.equal(turned.height, turn.image(plain.height))
    assert turned.texel_size == 2.0 * 2.0 / 1024


def test_training_listens_to_it(small_pack, entry, tmp_path):
    """The same run with and without it ends elsewhere, and says how far the truth is."""
    real = tuple(e for e in small_pack.entries if not e.simulated)
    pack = replace(small_pack, entries=(*real, entry))
    config = TrainConfig(
        steps=1, materials=1, places=1, window=64, report_every=1, real_share=0.0, relit=1.0
    )
    ends = [
        train(pack, replace(config, relit=relit), tmp_path / f"{relit}").model.decoder.state_dict()
        for relit in (0.0, 1.0)
    ]
    assert any(not torch.equal(ends[0][name], ends[1][name]) for name in ends[0])
    for relit in (0.0, 1.0):
        with (tmp_path / f"{relit}" / "curves.csv").open() as file:
            (row,) = csv.DictReader(file)
        assert (float(row.get("relit", 0.0)) > 0.0) == bool(relit)
