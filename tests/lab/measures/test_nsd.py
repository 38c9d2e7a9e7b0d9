"""The measure that nothing is tuned by, mostly with random weights."""

import struct

import numpy as np
import pytest
import torch

from matcap.errors import MatcapError
from matcap.lab.measures.nsd import SqueezeNetStyle, StyleRatio, style_distance
from matcap.lab.measures.patches import Patches
from matcap.lab.measures.squeezenet import WEIGHTS, SqueezeNet
from matcap.lab.measures.style import RandomFilters


@pytest.fixture(scope="module")
def style():
    return SqueezeNetStyle(random_network(0))


def random_network(seed):
    torch.manual_seed(seed)
    return SqueezeNet()


def ncnn(network):
    """A network's weights as ncnn writes them."""
    data = b""
    for module in network.modules():
        if isinstance(module, torch.nn.Conv2d):
            half = module.weight.numpy().astype("<f2").tobytes()
            data += struct.pack("<I", 0x01306B47) + half + b"\0" * (-len(half) % 4)
            data += module.bias.numpy().astype("<f4").tobytes()
    return data


def stripes(period, phase=0.0, size=128):
    wave = 0.5 + 0.3 * torch.sin(2.0 * torch.pi * (torch.arange(size) + phase) / period)
    return wave.expand(1, 3, size, size)


def test_weights_are_read_in_ncnn_s_order(tmp_path):
    network = random_network(1)
    path = tmp_path / "weights.bin"
    path.write_bytes(ncnn(network) + b"classifier")
    picture = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(2))
    for read, written in zip(SqueezeNet.load(path)(picture), network(picture), strict=True):
        assert torch.allclose(read, written, atol=2e-3)


@pytest.mark.parametrize("change", [lambda d: d[:5000], lambda d: b"?" + d[1:]])
def test_another_file_is_refused(tmp_path, change):
    path = tmp_path / "weights.bin"
    path.write_bytes(change(ncnn(random_network(1))))
    with pytest.raises(MatcapError, match=r"not SqueezeNet 1\.1"):
        SqueezeNet.load(path)


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(MatcapError, match="cannot be read"):
        SqueezeNet.load(tmp_path / "none.bin")


def test_the_weights_that_come_along_are_whole():
    network = SqueezeNet.load()
    assert WEIGHTS.stat().st_size > 2_400_000
    assert all(np.isfinite(p.numpy()).all() and float(p.std()) > 0 for p in network.parameters())


def test_distance_is_0_for_equals_and_symmetric(style):
    first, second = stripes(8), stripes(23)
    assert style_distance(style, first, first) == 0.0
    there, back = style_distance(style, first, second), style_distance(style, second, first)
    assert there == pytest.approx(back) and 0.0 < there <= 2.0


def test_places_do_not_count_and_patterns_do():
    style = SqueezeNetStyle()
    moved = style_distance(style, stripes(8), stripes(8, phase=3))
    assert style_distance(style, stripes(8), stripes(13)) > 2.0 * moved


def test_another_true_sample_has_a_normalised_distance_of_1(style):
    generator = torch.Generator().manual_seed(0)
    samples = [torch.rand(1, 3, 128, 128, generator=generator) for _ in range(3)]
    nsd = StyleRatio(style, samples[1:])
    assert nsd.of(samples[0]) == pytest.approx(1.0, abs=0.3)
    assert nsd.of(stripes(8)) > 3.0


# By the code of 2026-11-25, whose measurements docs/bench holds: distances of the first picture to
# the second and third, and normalised distance of the third to both.
REFERENCES = {
    SqueezeNetStyle: (0.8396788, 1.0320144, 1.0659100),
    Patches: (0.1768731, 0.1749630, 1.1018112),
    RandomFilters: (0.8063543, 0.9300728, 1.1456383),
}


@pytest.mark.parametrize("kind", REFERENCES)
def test_distances_stay_what_was_measured_by(kind):
    generator = torch.Generator().manual_seed(5)
    first, second, third = (torch.rand(2, 3, 128, 128, generator=generator) for _ in range(3))
    second = 0.3 + 0.5 * second
    wave = torch.sin(torch.arange(128) / 9.0).expand(2, 3, 128, 128)
    third = (0.5 * third + 0.25 * wave + 0.25).clamp(0, 1)
    style = kind()
    found = (
        style_distance(style, first, second),
        style_distance(style, first, third),
        StyleRatio(style, [first, second]).of(third),
    )
    assert found == pytest.approx(REFERENCES[kind], rel=1e-3)


def test_small_pictures_are_refused(style):
    with pytest.raises(ValueError, match="too small"):
        style(torch.zeros(1, 3, 64, 64))
