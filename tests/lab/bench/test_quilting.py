"""Image quilting: texels of the source alone, joined where the seam costs least."""

import itertools

import numpy as np
import pytest
import torch

from matcap.errors import UsageError
from matcap.lab.bench.quilting import QuiltSettings, cheapest_path, quilt

SMALL = QuiltSettings(block=18, overlap=3)


def source(seed: int, size: int = 48) -> torch.Tensor:
    """Blobs, so that some blocks fit better than others; no two texels have the same colour."""
    noise = torch.rand(3, size, size, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.avg_pool2d(noise[None], 5, 1, 2)[0] + 1e-3 * noise


def colours(picture: torch.Tensor) -> set[tuple[float, ...]]:
    return {tuple(texel) for texel in picture.flatten(1).T.tolist()}


@pytest.mark.parametrize("size", [(70, 50), (18, 18), (5, 7), (19, 40)])
def test_a_quilt_has_the_size_asked_for_and_texels_of_its_source_alone(size):
    width, height = size
    made = quilt(source(0), width, height, 1, SMALL)
    assert made.shape == (3, height, width)
    assert colours(made) <= colours(source(0))


def test_a_constant_picture_gives_itself():
    grey = torch.full((3, 40, 40), 0.3)
    assert torch.equal(quilt(grey, 64, 64, 0, SMALL), grey[:, :1, :1].expand(3, 64, 64))


def test_a_quilt_follows_from_its_seed():
    one, again, other = (quilt(source(2), 60, 60, seed, SMALL) for seed in (0, 0, 1))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


def test_a_quilt_is_no_copy_of_the_source():
    texture = source(3)
    made = quilt(texture, 48, 48, 4, SMALL)
    places = itertools.product(range(48), range(48))
    assert not any(torch.equal(made, texture.roll(place, dims=(-2, -1))) for place in places)


def test_seams_are_fainter_than_those_of_blocks_laid_at_random():
    texture = source(5, 96)

    def steps(picture):
        """How far texels beside each other are apart."""
        return float((picture[..., 1:] - picture[..., :-1]).abs().mean())

    quilted = quilt(texture, 180, 90, 0, SMALL)
    anyhow = quilt(texture, 180, 90, 0, QuiltSettings(block=18, overlap=3, tolerance=1e9))
    assert steps(quilted) - steps(texture) < 0.5 * (steps(anyhow) - steps(texture))


def test_the_cheapest_path_is_the_cheapest_of_all():
    cost = np.random.default_rng(0).random((5, 4)).astype(np.float32)
    every = [
        path
        for path in itertools.product(range(4), repeat=5)
        if all(abs(a - b) <= 1 for a, b in itertools.pairwise(path))
    ]
    best = min(every, key=lambda path: sum(cost[row, column] for row, column in enumerate(path)))
    assert cheapest_path(cost).tolist() == list(best)


def test_a_source_without_a_block_is_refused():
    with pytest.raises(UsageError, match="40 x 17 texels has no block of 18"):
        quilt(torch.zeros(3, 17, 40), 64, 64, 0, SMALL)
