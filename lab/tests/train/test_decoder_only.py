"""DECODERONLY: white noise at every level, an endless field, and fine-tuned like any decoder."""

import math

import pytest
import torch
from packs import entry
from small import SMALL, coarse

from matcap.field.plane import Rectangle
from matcap.flash.plane import read_plane
from matcap.space.decoder import CODE_SIZE, DEPTH, OUTPUTS, Decoder
from matcap.space.freeze import freeze
from matcap.space.patch import Patch
from matcap.space.random_field import random_field
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import TuneSettings, finetune
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.start import untrained
from matcap.space.tuning.windows import cut_windows
from matcap.statistics.filterbank import FilterBank, FilterBankConfig
from matcap.statistics.lattice import Wave
from matcap_lab.train.decoder_only import DecoderOnly, Unfolded

CODE = torch.zeros(CODE_SIZE)
WAVES = (Wave(0.05, 0.01),)


def decoder(kind=DecoderOnly) -> Decoder:
    return untrained(SMALL, coarse(), torch.full((3,), 0.2), 0, kind)


@pytest.fixture(scope="module")
def frozen() -> Unfolded:
    made = decoder().eval().requires_grad_(False)
    return Unfolded(made, CODE, tuple(freeze(made, CODE, WAVES)), WAVES, 0.01)


def test_it_decodes_a_field_of_its_own_channels():
    made = decoder()
    field = random_field(
        Patch(3, Rectangle(0, 0, 64, 32)), made.config.noise_channels, (), levels=DEPTH
    )
    raw = made(field, CODE)
    assert raw.shape == (1, OUTPUTS, 32, 64)
    assert bool(torch.isfinite(raw).all())


def test_every_level_reads_white_noise_of_its_own():
    made = decoder()
    field = random_field(
        Patch(1, Rectangle(0, 0, 256, 256)), made.config.noise_channels, (), levels=0
    )
    read = made.way_down(field.noise, lambda layer: lambda noise: noise)
    assert [noise.shape[-1] for noise in read] == [256, 128, 64, 32, 16]
    for level, noise in enumerate(read):
        count = noise.numel()
        assert abs(float(noise.mean())) < 5.0 / math.sqrt(count)
        beside = (noise[..., 1:] * noise[..., :-1]).mean()
        assert abs(float(beside)) < 5.0 / math.sqrt(count)
        for finer in read[:level]:  # the same places of finer levels know nothing of it
            stride = finer.shape[-1] // noise.shape[-1]
            together = (finer[..., ::stride, ::stride] * noise).mean()
            assert abs(float(together)) < 5.0 / math.sqrt(count)


def test_its_maps_follow_from_the_seed(frozen):
    one, again, other = (frozen.maps(64, 64, seed=seed).stacked() for seed in (1, 1, 2))
    assert torch.equal(one, again)
    assert float((one - other).abs().mean()) > 1e-3


def test_its_maps_are_pieces_of_one_endless_field(frozen):
    whole = frozen.maps(96, 64, seed=4).stacked()
    piece = frozen.maps(48, 32, seed=4, x=32, y=16).stacked()
    torch.testing.assert_close(whole[..., 16:48, 32:80], piece, rtol=1e-4, atol=1e-5)


def test_unfolded_reads_a_shipped_decoder_as_a_material_does():
    made = decoder(Decoder).eval().requires_grad_(False)
    moments = tuple(freeze(made, CODE, WAVES))
    plain = Unfolded(made, CODE, moments, WAVES, 0.01).maps(64, 64, seed=5).stacked()
    tuned = TunedDecoder(made, CODE, moments, WAVES, 0.01)
    folded = tuned.material("m", coarse().setup).maps(64, 64, seed=5)
    torch.testing.assert_close(plain, folded.stacked(), rtol=1e-3, atol=1e-4)


def test_it_tunes_with_a_finite_loss():
    photographed = entry("m", 0)
    plane = read_plane(photographed.photo(), photographed.coarse.setup, 192)
    bank = FilterBank(FilterBankConfig(sizes=(3,), filters=8, levels=3))
    windows = cut_windows(plane, bank, 64)
    scene = PhotographTarget(
        windows, photographed.coarse.setup, plane.encoding, bank, WAVES, 2.0 / 192
    )
    before = decoder().state_dict()
    tuned = finetune(decoder(), CODE, scene, TuneSettings(steps=2), lambda *_: None)
    assert [step for _, step, _ in tuned.history] == [1, 2]
    assert all(math.isfinite(error) for _, _, error in tuned.history)
    after = tuned.decoder.state_dict()
    assert not torch.equal(
        after["down.2.0.convolution.weight"], before["down.2.0.convolution.weight"]
    )
