"""The prior's file: what was written is read, and whatever is wrong is one error that names it."""

import json

import pytest
import torch
from safetensors.torch import load_file, save_file
from small import coarse, small_photo

from matcap.errors import MatcapError
from matcap.flash.plane import read_plane
from matcap.space.decoder import CODE_SIZE
from matcap.space.prior.base import base_of
from matcap.space.prior.store import load_prior
from matcap.space.tuning.start import log_contrast


@pytest.fixture
def path(prior, tmp_path):
    path = tmp_path / "prior.safetensors"
    prior.save(path)
    return path


def rewrite(path, change_tensors=None, change_about=None):
    from safetensors import safe_open

    with safe_open(path, "pt") as file:
        about = json.loads(file.metadata()["matcap"])
    tensors = load_file(path)
    if change_tensors:
        change_tensors(tensors)
    if change_about:
        change_about(about)
    save_file(tensors, path, {"matcap": json.dumps(about)})


def test_a_prior_comes_back_in_half_precision(prior, path):
    again = load_prior(path)
    for name, value in prior.decoder.state_dict().items():
        assert torch.equal(again.decoder.state_dict()[name], value.half().float())
    assert again.about == {"steps": 0}
    assert again.encoder.config == prior.encoder.config


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda t: t.pop("decoder.head.convolution.weight"), "decoder.head.convolution.weight"),
        (lambda t: t.update({"habits.offset": torch.zeros(3)}), r"habits.offset has shape \(3,\)"),
        (lambda t: t["encoder.head.bias"].fill_(float("nan")), "encoder.head.bias holds NaN"),
    ],
)
def test_a_wrong_tensor_is_named(path, change, message):
    rewrite(path, change)
    with pytest.raises(MatcapError, match=message):
        load_prior(path)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda a: a.update(version=99), "version 99"),
        (lambda a: a.update(format="matcap-material"), "matcap-material, not a prior"),
        (lambda a: a["encoder"].update(backbone="vit"), "description is damaged"),
        (lambda a: a["decoder"].update(widths=[8, 8]), "description is damaged"),
        (lambda a: a["decoder"].update(widths=[10**9] * 5), "description is damaged"),
        (lambda a: a.pop("decoder"), "description is damaged"),
    ],
)
def test_a_wrong_description_is_told(path, change, message):
    rewrite(path, change_about=change)
    with pytest.raises(MatcapError, match=message):
        load_prior(path)


def test_what_is_no_prior_is_refused(tmp_path):
    garbage = tmp_path / "garbage"
    garbage.write_bytes(b"\x10" * 100)
    foreign = tmp_path / "foreign.safetensors"
    save_file({"x": torch.zeros(2)}, foreign)
    for path, message in (
        (garbage, "damaged"),
        (foreign, "not a matcap prior"),
        (tmp_path, "folder"),
        (tmp_path / "absent", "no such prior"),
    ):
        with pytest.raises(MatcapError, match=message):
            load_prior(path)


def test_a_truncated_file_is_refused(path):
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(MatcapError, match="damaged"):
        load_prior(path)


def test_a_start_states_the_photographs_base(prior):
    photo, fit = small_photo(0), coarse()
    plane = read_plane(photo, fit.setup, 256)
    prior.decoder.head.adain.affine.weight.data.zero_()
    decoder, code = prior.start(photo.pixels, fit, plane)
    assert code.shape == (CODE_SIZE,)
    mean, deviation = decoder.head.adain.target(code)
    base = base_of(fit, log_contrast(plane.linear, plane.valid))
    torch.testing.assert_close(mean, base.mean)
    torch.testing.assert_close(deviation[:3], base.deviation[:3])
    assert all(p.requires_grad for p in decoder.parameters())


def test_draws_repeat_and_differ_by_seed(prior):
    first, again, other = prior.draw(5), prior.draw(5), prior.draw(6)
    one, two, three = (m.maps(64, 64).stacked() for m in (first, again, other))
    assert torch.equal(one, two)
    assert float((one - three).abs().mean()) > 1e-3
    assert bool(torch.isfinite(one).all())


def test_drawing_follows_the_habits(prior):
    """Means over many draws are the habits' offset; a sigmoid's argument is the decoder's mean."""
    from matcap.space.prior.base import base_from, varying

    offset = prior.conditional_mean.offset
    torch.testing.assert_close(varying(base_from(offset)), offset)
