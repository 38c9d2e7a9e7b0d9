"""VGG-19 with random weights: its shape, its file, and textures compared by it."""

import pytest
import torch
from safetensors.torch import save_file

from matcap.capture.settings import CaptureSettings, Statistics
from matcap.capture.target import Vgg19, _features, load_vgg19
from matcap.errors import MatcapError, UsageError
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.encoding import fit_encoding


@pytest.fixture(scope="module")
def network():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Vgg19(levels=2)


def picture(seed=0, side=48):
    return 0.4 * torch.rand(1, 3, side, side, generator=torch.Generator().manual_seed(seed))


def test_its_parameters_have_torchvisions_names_and_shapes(network):
    shapes = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    assert shapes["features.0.weight"] == (64, 3, 3, 3)
    assert shapes["features.10.weight"] == (256, 128, 3, 3)
    assert shapes["features.28.bias"] == (512,)
    assert len(shapes) == 2 * 13
    assert not any(parameter.requires_grad for parameter in network.parameters())


def test_five_layers_are_looked_at(network):
    found = network.maps(picture(), ())
    assert [tuple(f.shape[1:]) for f in found] == [
        (64, 48, 48), (128, 24, 24), (256, 12, 12), (512, 6, 6), (512, 3, 3),
    ]  # fmt: skip
    assert all(f.min() >= 0 for f in found)


def test_textures_are_compared_and_the_gradient_reaches_the_picture(network):
    encoding = fit_encoding(picture()[0], torch.ones(48, 48, dtype=torch.bool))
    target = describe(picture(), encoding, network)
    assert len(target.grams) == 5 and len(target.spectra) == 2
    assert float(distance(target, target, Weights())) == 0
    rendered = torch.cat([picture(1)[..., :24, :], torch.zeros(1, 3, 24, 48)], dim=2)
    rendered.requires_grad_()
    loss = distance(describe(rendered, encoding, network), target, Weights()).sum()
    loss.backward()
    assert torch.isfinite(rendered.grad).all() and rendered.grad.abs().max() > 0


def test_weights_are_read_by_name_and_anything_else_is_refused(network, tmp_path):
    path = tmp_path / "vgg19.safetensors"
    extra = {"classifier.0.weight": torch.zeros(2, 2)}  # the published file holds more
    save_file({**network.state_dict(), **extra}, path)
    read = _features(CaptureSettings(statistics=Statistics.parse(f"vgg19={path}")))
    assert all(
        torch.equal(a, b)
        for a, b in zip(read.state_dict().values(), network.state_dict().values(), strict=True)
    )
    save_file({"features.0.weight": torch.zeros(64, 3, 5, 5)}, path)
    other = tmp_path / "vgg19.pth"
    other.write_bytes(b"something else")
    for wrong, why in [(path, "not VGG-19"), (other, "SHA-256"), (tmp_path / "none", "no such")]:
        with pytest.raises(MatcapError, match=why):
            load_vgg19(wrong)


@pytest.mark.parametrize("statistics", ["vgg19", "vgg16", ""])
def test_unknown_statistics_are_wrong_usage(statistics):
    with pytest.raises(UsageError, match="no statistics"):
        Statistics.parse(statistics)


@pytest.mark.parametrize("words", ["filterbank", "vgg19=some/file.pth"])
def test_settings_tell_of_statistics_in_words(words):
    settings = CaptureSettings.of({"statistics": words})
    assert settings.statistics == Statistics.parse(words)
    assert settings.named()["statistics"] == str(settings.statistics) == words
    assert CaptureSettings.of(settings.named()) == settings
    assert CaptureSettings().named()["statistics"] == "filterbank"
