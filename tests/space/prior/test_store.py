"""The prior, its file and its anchors."""

import json
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file, save_file
from small import coarse, small_photo

from matcap.errors import MatcapError, UsageError
from matcap.flash.rectify import read_plane
from matcap.space.decoder import CODE_SIZE
from matcap.space.prior.store import VARYING, Anchor, Anchors, base_of, load_prior, varying
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.match import log_contrast
from matcap.statistics.lattice import Wave

# The prior's file: what was written is read, and whatever is wrong is one error that names it.


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


def test_a_prior_is_read_back_in_half_precision(prior, path):
    again = load_prior(path)
    for name, value in prior.decoder.state_dict().items():
        assert torch.equal(again.decoder.state_dict()[name], value.half().float())
    assert again.about == {"steps": 0} and again.encoder.config == prior.encoder.config


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
def test_a_wrong_description_is_refused(path, change, message):
    rewrite(path, change_about=change)
    with pytest.raises(MatcapError, match=message):
        load_prior(path)


def test_other_files_are_no_prior(tmp_path):
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
    assert torch.equal(one, two) and float((one - three).abs().mean()) > 1e-3
    assert bool(torch.isfinite(one).all())


def test_draws_have_the_conditional_mean(prior):
    """Means over many draws are the habits' offset; a sigmoid's argument is the decoder's mean."""
    from matcap.space.prior.store import base_from, varying

    offset = prior.conditional_mean.offset
    torch.testing.assert_close(varying(base_from(offset)), offset)


# Anchors in the space, and what lies near them.


WOVEN = (Wave(0.0625, 0.0), Wave(0.0, 0.125))


def anchor(seed, waves=()):
    numbers = torch.randn(CODE_SIZE + VARYING, generator=torch.Generator().manual_seed(seed))
    return Anchor(numbers[:CODE_SIZE], numbers[CODE_SIZE:], waves)


@pytest.fixture
def known(prior):
    """A prior that knows two anchors."""
    one, other = anchor(1, WOVEN), anchor(2)
    codes, rest = (torch.stack([getattr(a, key) for a in (one, other)]) for key in ("code", "rest"))
    waves = torch.tensor([WOVEN, ((0.0, 0.0), (0.0, 0.0))])
    return replace(prior, anchors=Anchors(codes, rest, waves))


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_a_draw_without_spread_is_its_anchor():
    here = anchor(1, WOVEN)
    drawn = here.near(0.0, generator())
    assert torch.equal(drawn.code, here.code) and torch.equal(drawn.rest, here.rest)
    assert drawn.waves == WOVEN


def test_a_draw_of_full_spread_keeps_only_the_lattice_of_its_anchor():
    one, other = anchor(1).near(1.0, generator()), anchor(2).near(1.0, generator())
    assert torch.equal(one.code, other.code)


def test_more_spread_is_farther_and_keeps_the_variance():
    here = anchor(1)
    steps = [here.near(spread, generator()) for spread in (0.1, 0.3, 0.6)]
    apart = [float((step.code - here.code).norm()) for step in steps]
    assert apart == sorted(apart)
    many = torch.stack([anchor(i).near(0.6, generator(i + 999)).code for i in range(400)])
    assert float(many.var(0).mean()) == pytest.approx(1.0, abs=0.05)


def test_the_base_is_predicted_from_code_and_rest(prior):
    habits, code = prior.conditional_mean, anchor(3).code
    base = base_of(coarse(), torch.tensor([0.2, 0.3, 0.25]))
    again = habits.base(code, habits.rest(code, base))
    torch.testing.assert_close(varying(again), varying(base), atol=1e-4, rtol=1e-4)


def test_draws_are_near_anchors_and_have_their_lattice(known):
    draws = [known.draw(seed, spread=0.05).part(TunedDecoder) for seed in range(8)]
    assert {draw.waves for draw in draws} == {WOVEN, ()}
    codes = torch.stack([draw.code for draw in draws])
    assert float(torch.cdist(codes, known.anchors.codes).min(dim=1).values.max()) < 0.15 * 8.0


def test_a_draw_may_be_near_a_given_code(known):
    here = anchor(7, WOVEN)
    at, near, far = (known.draw(3, near=here, spread=t) for t in (0.0, 0.3, 1.0))
    at, near, far = (material.part(TunedDecoder) for material in (at, near, far))
    assert torch.equal(at.code, here.code) and [each.waves for each in (at, near)] == [WOVEN, WOVEN]
    assert float((near.code - here.code).norm()) < float((far.code - here.code).norm())


@pytest.mark.parametrize("spread", [-0.1, 1.5, float("nan")])
def test_a_spread_out_of_range_is_refused(known, spread):
    with pytest.raises(UsageError, match="between 0 and 1"):
        known.draw(0, spread=spread)


def test_a_photograph_is_encoded_to_a_place(known):
    place = known.place(small_photo(0))
    assert place.code.shape == (CODE_SIZE,) and place.rest.shape == (VARYING,)
    assert bool(torch.isfinite(known.draw(0, near=place).maps(48, 32).stacked()).all())


def test_anchors_come_back_with_their_prior(known, tmp_path):
    known.save(tmp_path / "prior.safetensors")
    again = load_prior(tmp_path / "prior.safetensors")
    assert len(again.anchors) == 2 and torch.equal(again.anchors.codes, known.anchors.codes)
    assert again.anchors[0].waves == WOVEN and again.anchors[1].waves == ()
