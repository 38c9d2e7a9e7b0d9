"""Fine-tuning of a decoder."""

import math
import time
from dataclasses import replace
from functools import cache

import pytest
import torch
from plain_decoder import decoded
from tuning import CODE, CONFIG, WINDOW, scene, start, tune

from matcap.brdf.maps import MapSet
from matcap.field.plane import Rectangle
from matcap.flash.light import render_flash
from matcap.space.decoder import DEPTH, Decoder, DecoderConfig, maps_from_raw, with_cells
from matcap.space.freeze import fold, freeze
from matcap.space.random_field import CELL_CHANNELS, WAVE_CHANNELS, Patch, RandomField, random_field
from matcap.space.tuning import finetune
from matcap.space.tuning.finetune import Optimiser, map_penalty
from matcap.space.tuning.match import reading_cells
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.lattice import Wave

# Fine-tuning: what it promises of error, time, determinism and going wrong.


def error_of(decoder, moments=None):
    """Distance to the photograph over every window, with noise that tuning never saw."""
    seen, seeds, total = scene(), range(100, 108), 0.0
    with torch.no_grad():
        for seed in seeds:
            patch = Patch(seed, Rectangle(0, 0, WINDOW, WINDOW), period=(WINDOW, WINDOW))
            field = random_field(patch, CONFIG.noise_channels, (), levels=DEPTH)
            maps = maps_from_raw(decoder(field, CODE, moments), seen.texel_size, periodic=True)
            rendered = render_flash(maps, seen.setup, seen.windows.points)
            found = describe(rendered, seen.encoding, seen.bank)
            total += float(distance(found, seen.windows.target, Weights()).mean())
    return total / len(seeds)


@cache
def error_at_the_start():
    return error_of(start())


@cache
def tuned_long():
    return tune(steps=80)


def state_of(tuned):
    return tuned.decoder.state_dict()


def test_the_error_falls_on_unseen_noise():
    before, tuned = error_at_the_start(), tuned_long()
    assert error_of(tuned.decoder, list(tuned.moments)) < 0.8 * before


def test_the_returned_decoder_is_the_optimised_one():
    """Frozen statistics belong to the decoder: folded, it is the same network."""
    tuned = tuned_long()
    folded = fold(tuned.decoder, CODE, tuned.moments, has_waves=False)
    patch = Patch(7, Rectangle(0, 0, 256, 256))
    field = random_field(patch, CONFIG.noise_channels, (), levels=DEPTH)
    with torch.no_grad():
        one = decoded(folded, field)
        other = tuned.decoder(field, CODE, list(tuned.moments), periodic=False)
    inner = (..., slice(96, -96), slice(96, -96))
    assert torch.allclose(one[inner], other[inner], atol=1e-4)
    # And its frozen error is no worse than with statistics of the window at hand.
    assert error_of(tuned.decoder, list(tuned.moments)) < 1.15 * error_of(tuned.decoder)


@pytest.mark.parametrize("steps", [0, 1, 7])
def test_the_number_of_steps_is_kept(steps):
    lines = []
    tuned = tune(lambda *now: lines.append(now), steps=steps)
    assert len(tuned.history) == len(lines) == steps
    assert [step for _, step, _ in tuned.history] == list(range(1, steps + 1))
    assert len(tuned.moments) == len(tuned.decoder.layers()) and not tuned.interrupted


def test_the_time_limit_is_kept(monkeypatch):
    """By a clock that moves a hundredth of a second whenever it is looked at."""
    ticks = iter(range(10**6))
    monkeypatch.setattr(time, "monotonic", lambda: next(ticks) / 100.0)
    tuned = tune(steps=10**6, seconds=0.5)
    seconds = [second for second, _, _ in tuned.history]
    assert seconds == sorted(seconds) and 0.4 < seconds[-1] <= 0.52 and 10 <= len(seconds) <= 50
    assert len(tuned.moments) == len(tuned.decoder.layers())


def test_the_same_seed_is_the_same_bits_and_another_is_not():
    first, again, other = tune(steps=12), tune(steps=12), tune(steps=12, seed=1)
    for name, value in state_of(first).items():
        assert torch.equal(value, state_of(again)[name])
    assert any(not torch.equal(v, state_of(other)[n]) for n, v in state_of(first).items())


def test_ctrl_c_returns_the_best_so_far():
    def interrupt(share, error, seconds):
        if share >= 0.5:
            raise KeyboardInterrupt

    tuned = tune(interrupt, steps=40)
    assert tuned.interrupted and 15 <= len(tuned.history) <= 25
    assert error_of(tuned.decoder, list(tuned.moments)) < error_at_the_start()


class Sabotage:
    """Makes chosen steps go wrong: `how` gets the loss and the decoder."""

    def __init__(self, monkeypatch, steps, how):
        self.calls = 0
        true_take = Optimiser.take

        def take(optimiser, value, penalty, pace):
            self.calls += 1
            if self.calls - 1 in steps:
                value, penalty = how(value, penalty, optimiser._decoder)
            return true_take(optimiser, value, penalty, pace)

        monkeypatch.setattr(Optimiser, "take", take)


def poisoned_gradient(value, penalty, decoder):
    """A finite loss whose gradient is NaN: sqrt at 0, times 0."""
    zero = 0.0 * next(decoder.parameters()).sum()
    return value + zero.square().sqrt(), penalty


def nan_penalty(value, penalty, decoder):
    return value, penalty * math.nan


def infinite_loss(value, penalty, decoder):
    return value * math.inf, penalty


WAYS = [poisoned_gradient, nan_penalty, infinite_loss]


@pytest.mark.parametrize("how", WAYS)
def test_steps_that_are_not_finite_are_left_out(monkeypatch, how):
    """The first, two in a row, and the last among them."""
    Sabotage(monkeypatch, {0, 10, 11, 30, 39}, how)
    tuned = tune(steps=40)
    assert all(bool(torch.isfinite(value).all()) for value in state_of(tuned).values())
    assert all(bool(torch.isfinite(v).all()) for pair in tuned.moments for v in pair)
    assert error_of(tuned.decoder, list(tuned.moments)) < 1.05 * error_at_the_start()


@pytest.mark.parametrize("how", WAYS)
def test_without_a_finite_step_the_decoder_stays_as_it_was(monkeypatch, how):
    Sabotage(monkeypatch, range(1000), how)
    tuned = tune(steps=12)
    before = start().state_dict()
    for name, value in state_of(tuned).items():
        assert torch.equal(value, before[name])


def test_variation_of_gloss_is_penalised():
    even = torch.full((1, 1, 16, 16), 0.3)
    uneven = even + 0.1 * torch.rand((1, 1, 16, 16), generator=torch.Generator().manual_seed(1))
    diffuse = torch.full((1, 3, 16, 16), 0.3)
    expected = torch.logit(torch.tensor([0.3] * 5))

    def paid(specular, roughness, wanted=None):
        maps = MapSet(diffuse, specular, roughness, 0.0 * even, 0.01)
        return float(map_penalty(maps, wanted, 0.0))

    flat = paid(even, even)
    assert paid(uneven, even) > flat and paid(even, uneven) > flat
    assert paid(even, even, expected) == pytest.approx(flat, abs=1e-7)
    assert paid(even + 0.2, even, expected) > paid(even + 0.1, even, expected) > flat


def test_outliers_are_penalised_in_the_second_half_and_patches_never(monkeypatch):
    monkeypatch.setattr(finetune, "_SPECULAR", 0.0)
    row = torch.arange(64)
    everywhere = torch.full((1, 3, 64, 64), 0.3)

    def paid(metal, share):
        """Where there is metal; its gradient too, which must be finite on even maps."""
        specular = torch.where(metal, 0.7, 0.04)[None, None].requires_grad_(True)
        flat = torch.full((1, 1, 64, 64), 0.3)
        penalty = map_penalty(MapSet(everywhere, specular, flat, 0.0 * flat, 0.01), None, share)
        (gradient,) = torch.autograd.grad(penalty, specular, allow_unused=True)
        assert gradient is None or torch.isfinite(gradient).all()
        return float(penalty.detach())

    none = torch.zeros(64, 64, dtype=torch.bool)
    patches = (row[:, None] // 16 + row // 16) % 3 == 0
    specks = (row[:, None] % 16 == 3) & (row % 16 == 5)
    free = paid(none, 0.6)
    assert paid(specks, 0.4) == paid(none, 0.4) == free == pytest.approx(paid(patches, 0.6))
    assert paid(specks, 0.6) > free + 0.01


COPPER = torch.tensor([0.955, 0.638, 0.538])[:, None, None]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_coloured_f0_has_the_penalty_of_its_mean(share):
    draw = torch.rand(2, 6, 16, 24, generator=torch.Generator().manual_seed(1)) * 0.5 + 0.2
    grey = MapSet.from_stacked(draw, 0.1)
    coloured = replace(grey, specular=grey.specular * COPPER / COPPER.mean())
    paid, owed = (map_penalty(m, torch.zeros(5), share) for m in (coloured, grey))
    assert float(paid) == pytest.approx(float(owed), rel=1e-5) and float(paid) > 0.0


# The statistics that a fine-tuned decoder is frozen with are those of its own code.


@pytest.fixture
def frozen(monkeypatch):
    """Codes that were frozen at, in turn; the statistics are the true ones."""
    codes = []

    def remember(decoder, code, *read):
        codes.append(code.clone())
        return freeze(decoder, code, *read)

    monkeypatch.setattr(finetune, "freeze", remember)
    return codes


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("steps", "report"),
    [(0, lambda *_: None), (3, lambda *_: None), (20, interrupt)],
    ids=["no steps", "frozen end", "interrupted before it"],
)
def test_the_frozen_decoder_is_that_of_the_code(frozen, steps, report):
    code = torch.linspace(-1.0, 1.0, len(CODE))
    decoder = start()
    with torch.no_grad():  # an untrained decoder hardly heeds its code
        for layer in decoder.layers():
            layer.adain.affine.weight.normal_(0.0, 0.1)
    asked = finetune.TuneSettings(steps=steps, half_precision=False)
    tuned = finetune.finetune(decoder, code, scene(), asked, report)
    assert frozen and all(torch.equal(one, code) for one in frozen)
    assert len(tuned.moments) == len(decoder.layers())
    expected = freeze(tuned.decoder, code, ())
    elsewhere = freeze(tuned.decoder, 0.0 * code, ())

    def apart(moments):
        pairs = zip(tuned.moments, moments, strict=True)
        return sum(float((a[1] - b[1]).abs().mean()) for a, b in pairs)

    assert apart(expected) < 0.5 * apart(elsewhere)
    assert tuned.decoder.config == CONFIG


# A decoder that comes without cells, as the prior's does, learns to read them.


NARROW = DecoderConfig(noise_channels=2, widths=(4, 4, 6, 6, 6))
WAVES = (Wave(1 / 23.0, 0.0), Wave(0.0, 1 / 19.0))


def a_field():
    return random_field(
        Patch(4, Rectangle(0, 0, 64, 64)), 2, WAVES, levels=DEPTH, cells=CELL_CHANNELS
    )


def without_cells(field):
    return RandomField(field.noise, tuple(w[:, :WAVE_CHANNELS] for w in field.waves))


def test_zero_weights_of_cells_leave_the_decoder_unchanged():
    decoder = Decoder(NARROW)
    wider = reading_cells(decoder, 0)
    heard = torch.arange(WAVE_CHANNELS + CELL_CHANNELS)[:, None, None] < WAVE_CHANNELS
    silent = RandomField(a_field().noise, tuple(w * heard for w in a_field().waves))
    with torch.no_grad():
        expected = decoder(without_cells(a_field()), CODE)
        assert torch.allclose(wider(silent, CODE), expected, atol=1e-4)
        assert not torch.allclose(wider(a_field(), CODE), expected, atol=0.05)


def test_weights_of_cells_are_drawn_by_the_seed_and_trained():
    decoder = Decoder(NARROW)
    first, again, other = (reading_cells(decoder, seed).state_dict() for seed in (1, 1, 2))
    name = "up.0.0.convolution.weight"
    assert torch.equal(first[name], again[name]) and not torch.equal(first[name], other[name])
    wider = reading_cells(decoder, 1)
    wider(a_field(), CODE)[:, 0].square().mean().backward()
    assert float(wider.up[3][0].convolution.weight.grad[:, -CELL_CHANNELS:].abs().max()) > 0.0


def test_the_given_decoders_are_unchanged():
    decoder, other = Decoder(NARROW), reading_cells(Decoder(NARROW), 3)
    before = {name: value.clone() for name, value in other.state_dict().items()}
    mixed = with_cells(decoder, other)
    with torch.no_grad():
        mixed.head.convolution.weight.add_(1.0)
    assert all(torch.equal(value, before[name]) for name, value in other.state_dict().items())
    assert decoder.config.cells == 0
