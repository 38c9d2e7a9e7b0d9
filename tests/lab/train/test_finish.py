"""Standardised codes: the same pictures from codes of zero mean and unit variance."""

import torch
from small import SMALL

from matcap.lab.train.finish import codes_of, finish, standardise, with_anchors
from matcap.lab.train.step import fields
from matcap.space.prior.base import base_of


def test_standardising_changes_codes_and_no_picture(prior, pack):
    entries = pack.entries[:3]
    torch.nn.init.normal_(prior.encoder.head.weight, std=0.3)
    codes = codes_of(prior.encoder, entries)
    encoder, decoder = standardise(prior.encoder, prior.decoder, codes)
    after = codes_of(encoder, entries)
    mean, variance = after.aggregate
    torch.testing.assert_close(mean, torch.zeros(64), atol=1e-3, rtol=0)
    torch.testing.assert_close(variance, torch.ones(64), atol=1e-3, rtol=0)
    assert torch.allclose(after.mean, codes.standardised().mean, atol=1e-3)
    field = fields(SMALL, [()], 32, 1, "cpu")
    with torch.no_grad():
        before_picture = prior.decoder(field, codes.mean[0])
        after_picture = decoder(field, after.mean[0])
    torch.testing.assert_close(after_picture, before_picture, atol=1e-3, rtol=1e-3)


def test_a_finished_prior_knows_its_codes(prior, pack):
    done = finish(prior.encoder, prior.decoder, pack.entries[:3], {"steps": 1})
    assert done.about["steps"] == 1
    assert len(done.about["code_mean"]) == len(done.about["code_variance"]) == 64
    assert 0 <= done.about["dead_dimensions"] <= 64
    assert bool(torch.isfinite(done.draw(1).maps(32, 32).stacked()).all())
    assert done.anchors is not None and len(done.anchors) == 3


def test_draws_of_an_older_prior_are_led_to_photographs(prior, pack):
    entries = pack.entries[-3:]
    codes = codes_of(prior.encoder, entries)
    led = with_anchors(prior, entries)
    assert led.anchors is not None
    for index, entry in enumerate(entries):
        anchor = led.anchors[index]
        torch.testing.assert_close(anchor.code, codes.mean[index])
        assert len(anchor.waves) == len(entry.waves)
        base = led.conditional_mean.base(anchor.code, anchor.rest)
        wanted = base_of(entry.coarse, entry.contrast)
        torch.testing.assert_close(base.mean[:5], wanted.mean[:5], atol=1e-4, rtol=1e-4)
