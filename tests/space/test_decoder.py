"""The decoder, its layers, its input and interpolations."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from example.exemplars import PERIODS, blobs, bricks
from materials import a_material, quick_maps

from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.example.interpolate import interpolated
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.space.between import blend, blend_waves
from matcap.space.decoder import CODE_SIZE, DEPTH, AdaIN, Decoder, DecoderConfig, wrap
from matcap.space.freeze import freeze
from matcap.space.random_field import (
    _PHASES,
    CELL_CHANNELS,
    WAVE_CHANNELS,
    Patch,
    RandomField,
    cell_field,
    keys,
    lattice_field,
    noise_field,
    wave_field,
    wrap64,
)
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.match import reading_cells
from matcap.statistics.lattice import Wave

# AdaIN and the decoder around it: fused forms against the plain formulas.


TINY = DecoderConfig(noise_channels=2, widths=(4, 4, 4, 4, 4), convolutions=(1, 1))


@pytest.fixture
def features():
    torch.manual_seed(3)
    return 2.0 + 3.0 * torch.randn(2, 5, 16, 24)


@pytest.fixture
def adain():
    torch.manual_seed(4)
    return AdaIN(5)


def test_adain_sets_the_mean_and_deviation_of_the_code(adain, features):
    code = torch.randn(CODE_SIZE)
    mean, deviation = adain.target(code)
    found = adain(features, code, None)
    assert torch.allclose(found.mean((0, 2, 3)), mean, atol=1e-4)
    assert torch.allclose(found.std((0, 2, 3), correction=0), deviation.abs(), atol=1e-4)


def test_adain_with_measured_moments_is_adain(adain, features):
    code = torch.randn(CODE_SIZE)
    adapted, moments = adain.measured(features, code)
    assert torch.allclose(moments[0], features.mean((0, 2, 3)), atol=1e-5)
    assert torch.allclose(moments[1], features.std((0, 2, 3), correction=0), rtol=1e-4)
    assert torch.allclose(adapted, adain(features, code, None), atol=1e-5)
    assert torch.allclose(adain(features, code, moments), adain(features, code, None), atol=1e-5)


def test_adain_of_constant_features_is_finite_with_its_gradient(adain):
    constant = torch.full((1, 5, 8, 8), 7.0, requires_grad=True)
    adain(constant, torch.randn(CODE_SIZE), None).square().sum().backward()
    assert torch.isfinite(constant.grad).all() and torch.isfinite(adain.affine.weight.grad).all()


def test_gradients_of_a_decoder_follow_finite_differences():
    torch.manual_seed(5)
    decoder = Decoder(TINY).double()
    noise = noise_field(Patch(1, Rectangle(0, 0, 32, 32), period=(32, 32)), 2).double()
    waves = tuple(torch.zeros(1, WAVE_CHANNELS, 32 >> n, 32 >> n) for n in range(DEPTH))
    field = RandomField(noise.reshape(1, 2, 32, 32), waves)
    code = torch.randn(CODE_SIZE, dtype=torch.float64)
    weight = decoder.head.adain.affine.bias

    def loss():
        return decoder(field, code).square().mean()

    loss().backward()
    step = 1e-3
    with torch.no_grad():
        for index in (0, 7):
            weight[index] += step
            above = float(loss())
            weight[index] -= 2 * step
            below = float(loss())
            weight[index] += step
            assert float(weight.grad[index]) == pytest.approx((above - below) / 2 / step, rel=1e-2)


# A torus's border: the same numbers, and the same gradient, as circular padding's.


def padded(features: torch.Tensor) -> torch.Tensor:
    return F.pad(features, (1, 1, 1, 1), mode="circular")


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (4, 3), (16, 16)])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_wrap_equals_circular_padding(size, layout):
    torch.manual_seed(1)
    features = torch.randn(2, 3, *size).contiguous(memory_format=layout).requires_grad_(True)
    weight = torch.randn(2, 3, size[0] + 2, size[1] + 2)
    assert torch.equal(wrap(features), padded(features))
    (found,) = torch.autograd.grad((wrap(features) * weight).sum(), features)
    (wanted,) = torch.autograd.grad((padded(features) * weight).sum(), features)
    torch.testing.assert_close(found, wanted)


def test_wrap_passes_gradcheck():
    features = torch.randn(1, 2, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(wrap, (features,))


# Cells of regular order: whole, independent, the same wherever they are asked for.


STRAIGHT = (Wave(1 / 43.3, 0.0), Wave(0.0, 1 / 42.7))
OBLIQUE = (Wave(1 / 16.7, 0.003), Wave(-0.011, 1 / 9.3))
STRIPES = (Wave(0.0, 1 / 12.3),)
LATTICES = pytest.mark.parametrize("waves", [STRAIGHT, OBLIQUE, STRIPES])


def whole_turns(waves, seed, x, y, level=0):
    """What every wave has counted at a texel, by Python's integers."""
    start = keys(wrap64(seed ^ _PHASES), 2).tolist()
    counts = []
    for wave, begin in zip(waves, start, strict=False):
        step_x, step_y = round(wave.fx * 2**64), round(wave.fy * 2**64)
        middle = (step_x + step_y) * (2**level - 1) // 2
        counts.append((step_x * 2**level * x + step_y * 2**level * y + begin + middle) >> 64)
    return tuple(counts)


def numbers_of_cells(waves, x, y, size, level=0):
    """Every cell's numbers, and that no texel of it has others."""
    field = cell_field(Patch(5, Rectangle(x, y, size, size), level=level), waves, 3)
    found = {}
    for row in range(size):
        for column in range(size):
            cell = whole_turns(waves, 5, x + column, y + row, level)
            numbers = tuple(field[:, row, column].tolist())
            assert found.setdefault(cell, numbers) == numbers
    return found


@LATTICES
@pytest.mark.parametrize("corner", [(0, 0), (-70, 2**31 - 40), (2**40 - 90, -(2**40) + 3)])
def test_a_cell_is_where_every_wave_has_made_the_same_whole_turns(waves, corner):
    found = numbers_of_cells(waves, *corner, 60)
    assert len(found) >= 4 and len(set(found.values())) == len(found)


def test_all_levels_draw_the_same_numbers_for_a_cell():
    fine = numbers_of_cells(OBLIQUE, 32, -64, 64)
    coarse = numbers_of_cells(OBLIQUE, 16, -32, 32, level=1)
    shared = fine.keys() & coarse.keys()
    assert len(shared) > 20 and all(fine[cell] == coarse[cell] for cell in shared)


@LATTICES
def test_a_rectangle_is_cut_out_of_a_larger_one(waves):
    whole = cell_field(Patch(3, Rectangle(-50, -70, 200, 160)), waves, 4)
    part = cell_field(Patch(3, Rectangle(10, -10, 64, 33)), waves, 4)
    assert torch.equal(part, whole[:, 60:93, 60:124])


@LATTICES
@pytest.mark.parametrize("period", [(160, 96), (160, None), (None, 96)])
@pytest.mark.parametrize("level", [0, 2])
def test_cells_of_a_periodic_field_repeat_whole(waves, period, level):
    area = Rectangle(-30, 5, 480 >> level, 288 >> level)
    field = cell_field(Patch(3, area, level=level, period=period), waves, 2)
    shift = [length and length >> level for length in (period[1], period[0])]
    assert torch.equal(field, field.roll([s or 0 for s in shift], (1, 2)))
    if all(period) and len(waves) == 2 and level == 0:
        (a, b), (c, d) = ((round(w.fx * period[0]), round(w.fy * period[1])) for w in waves)
        # The lattice has as many cells in one repeat as its determinant says, and no scraps.
        assert field.flatten(1).unique(dim=1).shape[1] == abs(a * d - b * c)


def test_a_block_where_far_ends_meet_is_made_of_the_same_cells():
    period = (2**14, 2**14)
    meeting = cell_field(Patch(3, Rectangle(-20, -20, 64, 64), period=period), OBLIQUE, 2)
    corner = cell_field(Patch(3, Rectangle(0, 0, 44, 44), period=period), OBLIQUE, 2)
    assert torch.equal(meeting[:, 20:, 20:], corner)


def test_cells_have_zero_mean_and_unit_variance_and_are_independent():
    waves = Wave(0.25, 0.0), Wave(0.0, 0.25)
    cells = cell_field(Patch(1, Rectangle(0, 0, 800, 800)), waves, 2)[:, ::4, ::4]
    assert cells.mean(dim=(1, 2)).abs().max() < 0.02
    assert (cells.std(dim=(1, 2)) - 1.0).abs().max() < 0.02
    for other in (cells[1], cells[0].roll(1, 0), cells[0].roll(1, 1)):
        assert abs(float((cells[0] * other).mean())) < 0.02


def test_cells_too_fine_for_a_level_are_left_out():
    assert cell_field(Patch(1, Rectangle(0, 0, 8, 8), level=2), OBLIQUE, 2).abs().max() == 0
    assert cell_field(Patch(1, Rectangle(0, 0, 8, 8)), (), 2).abs().max() == 0


def test_channels_are_waves_then_cells():
    patch = Patch(9, Rectangle(4, 5, 20, 10))
    field = lattice_field(patch, STRAIGHT, 3)
    assert torch.equal(field[:WAVE_CHANNELS], wave_field(patch, STRAIGHT))
    assert torch.equal(field[WAVE_CHANNELS:], cell_field(patch, STRAIGHT, 3))
    assert torch.equal(lattice_field(patch, STRAIGHT, 0), field[:WAVE_CHANNELS])


# Blending: ends are the ends, the middle lies between, and the commands write what they say.


def test_the_ends_of_a_blend_are_the_given_materials(prior):
    a, b = prior.draw(1), prior.draw(2)
    assert blend(a, b, 0.0) is a and blend(a, b, 1.0) is b


def test_a_blend_near_an_end_is_similar_to_it(prior):
    a, b = prior.draw(1), prior.draw(2)
    first, last = (quick_maps(m, 64, 64).stacked()[:5] for m in (a, b))
    distances = []
    for share in (0.01, 0.25, 0.5, 0.75, 0.99):
        found = quick_maps(blend(a, b, share), 64, 64).stacked()[:5]
        distances.append((float((found - first).abs().mean()), float((found - last).abs().mean())))
    from_a, from_b = zip(*distances, strict=True)
    assert list(from_a) == sorted(from_a) and list(from_b) == sorted(from_b, reverse=True)
    assert from_a[0] < 0.05 * from_a[-1]


def test_the_middle_has_the_mean_weights_and_its_own_moments(prior):
    ends = prior.draw(1), prior.draw(2)
    a, b, middle = (m.part(TunedDecoder) for m in (*ends, blend(*ends, 0.5)))
    name = "head.adain.affine.bias"
    wanted = (a.decoder.state_dict()[name] + b.decoder.state_dict()[name]) / 2
    torch.testing.assert_close(middle.decoder.state_dict()[name], wanted)
    torch.testing.assert_close(middle.code, (a.code + b.code) / 2)
    assert any(not torch.equal(middle.moments[i][0], a.moments[i][0]) for i in (0, -1))


def test_negated_frequency_vectors_are_the_same_stripes():
    wave, backwards = Wave(0.1, 0.02), Wave(-0.1, -0.02)
    assert blend_waves((wave,), (backwards,), 0.5) == (wave,)
    assert blend_waves((wave,), (), 0.4) == (wave,) and blend_waves((wave,), (), 0.6) == ()


def test_a_material_without_order_blends_with_one_that_has_cells(prior):
    a, b = prior.draw(1), prior.draw(2)
    tuned = b.part(TunedDecoder)
    decoder, waves = reading_cells(tuned.decoder, 0), (Wave(1 / 20, 0.0),)
    moments = tuple(freeze(decoder, tuned.code, waves))
    ordered = replace(tuned, decoder=decoder, waves=waves, moments=moments)
    ordered = ordered.material("ordered", b.setup)
    for ends, share in (((a, ordered), 0.9), ((ordered, a), 0.1)):
        mostly_ordered = blend(*ends, share)
        made = mostly_ordered.part(TunedDecoder)
        assert made.waves == waves and made.decoder.config.cells == CELL_CHANNELS
        assert torch.isfinite(quick_maps(mostly_ordered, 64, 64).stacked()).all()


def test_incompatible_materials_are_not_blended(prior):
    a = prior.draw(1)
    with pytest.raises(UsageError, match="not between 0 and 1"):
        blend(a, a, 1.5)
    wider = Decoder(DecoderConfig(4, (8, 8, 8, 8, 16), (1, 1)))
    b = replace(a.part(TunedDecoder), decoder=wider, waves=()).material("b", a.setup)
    with pytest.raises(MatcapError, match="different shapes"):
        blend(a, b, 0.5)


def test_the_command_writes_materials_and_a_strip(prior, tmp_path, capsys):
    folder, b, out = tmp_path / "a", tmp_path / "b.matcap", tmp_path / "out"
    folder.mkdir()
    for seed, path in ((1, folder / "a.matcap"), (2, b)):
        prior.draw(seed).save(path)
    assert main(["blend", str(folder), str(b), "-t", "0:1:3", "-o", str(out)]) == 0
    assert capsys.readouterr().err.count("not their patterns") == 1
    made = [f"a_b_{share}.matcap" for share in ("0.000", "0.500", "1.000")]
    assert sorted(p.name for p in out.iterdir()) == [*made, "strip.png"]
    end = Material.load(out / "a_b_1.000.matcap").maps(64, 64).stacked()
    assert torch.equal(end, Material.load(b).maps(64, 64).stacked())


def test_exemplars_are_blended_to_an_exemplar_that_the_command_writes(tmp_path, capsys):
    spots, wall = Example.of(blobs()), Example.of(bricks())
    for name, example in (("spots", spots), ("wall", wall)):
        a_material(name, example=example).by("example").save(tmp_path / f"{name}.matcap")
    a, b, out = tmp_path / "spots.matcap", tmp_path / "wall.matcap", tmp_path / "out"
    assert main(["blend", str(a), str(b), "-o", str(out)]) == 0
    assert "patterns" not in capsys.readouterr().err
    middle = Material.load(out / "spots_wall_0.500.matcap")
    assert set(middle.generators) == {"example"}
    wanted = interpolated(spots.exemplar, wall.exemplar, 0.5).rounded().stacked()
    assert np.array_equal(middle.part(Example).exemplar.stacked(), wanted)
    assert main(["blend", str(a), str(b), "--generator", "decoder", "-o", str(out)]) == 2
    assert "spots has no decoder" in capsys.readouterr().err


def test_a_lattice_is_found_again_and_patches_keep_to_it():
    wall, spots = bricks(400, 320), Example.of(blobs(400, 320))
    wall = Example.of(replace(wall, diffuse=wall.roughness.repeat(3, axis=0)))  # of one colour
    ends = [a_material(example=example).by("example") for example in (wall, spots)]
    found = blend(*ends, 0.1).part(Example).index.lattice
    rows = [np.hypot(*wave) for wave in found.waves]
    assert np.abs(np.subtract.outer(rows, 1.0 / np.array(PERIODS))).min() < 1e-3


def test_setups_of_a_portrait_and_a_landscape_keep_the_nearer_ones_geometry():
    lying = a_material("lying", example=Example.of(blobs(112, 96))).by("example")
    turned = replace(lying.setup, turned=True, tilt=(0.1, 0.0), intensity=(3.0, 3.0, 3.0))
    standing = replace(lying, setup=turned)
    assert blend(lying, standing, 0.25).setup == lying.setup.with_intensity((1.5, 1.5, 1.5))
    assert blend(lying, standing, 0.75).setup == standing.setup.with_intensity((2.5, 2.5, 2.5))


@pytest.mark.parametrize("share", ["2", "0:1", "0:1:1", "a", "-1", "0:2:3"])
def test_a_blend_share_out_of_range_is_a_usage_error(tmp_path, share, capsys):
    assert main(["blend", "a", "b", f"-t={share}"]) == 2


def test_samples_are_drawn_from_a_given_prior(prior, tmp_path, capsys):
    prior.save(tmp_path / "p.safetensors")
    out = tmp_path / "s.png"
    arguments = ["sample", "-n", "3", "--prior", str(tmp_path / "p.safetensors"), "-o", str(out)]
    assert main(arguments) == 0 and out.stat().st_size > 1000
    assert main(["sample", "--prior", str(tmp_path / "none"), "-o", str(out)]) == 3


def test_the_shipped_prior_loads_and_draws():
    from matcap.space.prior import SHIPPED
    from matcap.space.prior.store import load_prior

    assert SHIPPED.stat().st_size < 30e6
    prior = load_prior()
    assert SHIPPED.with_suffix(".md").is_file() and len(prior.anchors) == 346
    assert bool(torch.isfinite(prior.draw(0).maps(32, 32).stacked()).all())
    mean = torch.tensor(prior.about["code_mean"])
    variance = torch.tensor(prior.about["code_variance"])
    assert float(mean.abs().max()) < 0.05 and float((variance - 1).abs().max()) < 0.05


def test_synth_without_a_material_draws_one(tmp_path, capsys):
    out = tmp_path / "maps"
    assert main(["synth", "--size", "96x32", "--seed", "7", "-o", str(out)]) == 0
    assert (out / "drawn_7.json").is_file()
    assert main(["synth", "--size", "32", "--seed", "-3", "-o", str(tmp_path / "more")]) == 0
