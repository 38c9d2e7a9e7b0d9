"""A decoder that reads a drawing: every seed's own, and untrained it is the prior's decoder."""

import math
from dataclasses import replace

import pytest
import torch
from example.exemplars import blobs, bricks
from materials import SMALL, a_material, quick_maps
from tuning import CODE, scene, start, tune

from matcap.cli.main import main
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.example.interpolate import interpolated
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.files.color import LUMINANCE
from matcap.space.between import blend
from matcap.space.decoder import ALIGNMENT, DEPTH, DRAWING_CHANNELS, Decoder, with_drawing
from matcap.space.freeze import AROUND, Drawing, reference_field
from matcap.space.random_field import Patch, random_field
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import Adam, Renormalisation, decode_window
from matcap.space.tuning.match import MARGIN, Teacher

AREA = Rectangle(-64, 32, 128, 96)


@pytest.fixture(scope="module")
def drawing():
    return Drawing(Example.of(blobs()))


@pytest.fixture(scope="module")
def drawn(drawing):
    return a_material("drawn", config=SMALL, drawing=drawing)


def test_with_weights_of_zero_it_is_the_decoder_that_it_was(drawing):
    torch.manual_seed(4)
    decoder = Decoder(SMALL)
    wider = with_drawing(decoder)
    field = reference_field(decoder.config, ())
    shown = reference_field(wider.config, (), drawing)
    with torch.no_grad():
        assert torch.allclose(wider(shown, CODE), decoder(field, CODE), atol=1e-5)
    assert decoder.config.drawing == 0 and with_drawing(wider) is wider
    wider(shown, CODE).square().mean().backward()
    width = SMALL.widths[0] + SMALL.widths[1]
    slope = wider.up[3][0].convolution.weight.grad[:, width : width + DRAWING_CHANNELS]
    assert float(slope.abs().max()) > 0.0


def test_levels_are_means_of_one_endless_drawing(drawing):
    levels = drawing.levels(3, AREA)
    assert [level.shape[2:] for level in levels] == [(96 >> k, 128 >> k) for k in range(DEPTH)]
    inner = drawing.levels(3, Rectangle(AREA.x + 32, AREA.y + 16, 64, 48))
    for k, (part, whole) in enumerate(zip(inner, levels, strict=True)):
        assert torch.allclose(part, whole[..., 16 >> k : 64 >> k, 32 >> k : 96 >> k], atol=1e-5)
    # By the exemplar's moments.
    wide = drawing.levels(3, Rectangle(0, 0, 512, 512))[0]
    assert wide.mean((0, 2, 3)).abs().max() < 0.2
    assert torch.allclose(wide.std((0, 2, 3)), torch.ones(DRAWING_CHANNELS), atol=0.2)


def test_the_field_has_the_drawing_of_its_seed(drawn, drawing):
    """Against the same decoder with another exemplar, which differs in nothing but the drawing."""
    tuned = drawn.part(TunedDecoder)
    other = replace(tuned, drawing=Drawing(Example.of(blobs(seed=2))))
    made = (each.material("m", drawn.setup) for each in (tuned, other))
    one, second = (quick_maps(each, 96, 64).stacked() for each in made)
    assert (one[:3] - second[:3]).abs().mean() > 0.01


def test_another_seed_is_another_drawing(drawn):
    """The noise is the same: only its weights are kept."""
    tuned = drawn.part(TunedDecoder)
    decoder = Decoder(tuned.decoder.config)
    decoder.load_state_dict(tuned.decoder.state_dict())
    decoder.down[0][0].convolution.weight.data.zero_()
    material = replace(tuned, decoder=decoder).material("m", drawn.setup)
    first, again, other = (quick_maps(material, 64, 64, seed=s).diffuse for s in (1, 1, 2))
    assert torch.equal(first, again) and (first - other).abs().mean() > 0.01


def test_its_periods_are_those_of_both_generators(drawn, drawing):
    repeat = drawn.alignment
    assert repeat % ALIGNMENT == 0 and repeat % drawing.alignment == 0


def test_what_is_taught_is_the_field_that_is_drawn(drawing):
    lesson = Teacher.of(drawing, 48, 5).lesson(7)
    assert lesson.drawing[0].shape == (1, DRAWING_CHANNELS, 48 + 2 * MARGIN, 48 + 2 * MARGIN)
    assert lesson.maps.size == (48, 48) and float(lesson.loss(lesson.maps)) == 0.0
    shifted = replace(lesson.maps, diffuse=lesson.maps.diffuse.roll(5, -1))
    bumpy = replace(lesson.maps, height=lesson.maps.height.roll(5, -1))
    assert float(lesson.loss(shifted)) > 0.1 and float(lesson.loss(bumpy)) > 0.01
    colour = lesson.maps.diffuse
    luminance = torch.einsum("c,bchw->bhw", colour.new_tensor(LUMINANCE), colour).log()
    seen = lesson.drawing[0][:, 0, MARGIN:-MARGIN, MARGIN:-MARGIN]
    assert _correlation(luminance, seen) > 0.99


def test_fine_tuned_it_draws(drawing):
    """It comes nearer to maps that it was never taught, which without a teacher it does not."""
    target = replace(scene(), drawing=drawing)
    held_out = Teacher.of(drawing, 48, 99).lesson(3)

    def difference(decoder, moments):
        with torch.no_grad():
            run = lambda field: decoder(field, CODE, moments)  # noqa: E731
            maps = decode_window(decoder.config, run, target, 5, held_out, half_precision=False)
            return float(held_out.loss(maps))

    before = difference(with_drawing(start()), None)
    tuned = tune(steps=30, decoder=with_drawing(start()), seen=target, learning_rate=2e-2)
    assert difference(tuned.decoder, list(tuned.moments)) < 0.85 * before


def test_the_weights_that_read_a_drawing_move_farther():
    """Adam's first step is the rate for every weight but these, which start at zero."""
    decoder = with_drawing(start())
    optimiser, rate = Adam(decoder), 1e-3
    for parameter in decoder.parameters():
        parameter.grad = torch.ones_like(parameter)
    before = decoder.up[0][0].convolution.weight.detach().clone()
    optimiser.step(rate)
    after, of_lattice = decoder.up[0][0].convolution.weight, decoder.config.lattice_channels
    moved = (before - after.detach()).mean((0, 2, 3)) / rate
    of_features = len(moved) - of_lattice - DRAWING_CHANNELS
    features, drawn, lattice = moved.split([of_features, DRAWING_CHANNELS, of_lattice])
    assert drawn.tolist() == pytest.approx([9.0] * DRAWING_CHANNELS, rel=1e-3)
    assert torch.cat([features, lattice]).sub(1.0).abs().max() < 1e-3


def test_relief_that_lights_hardly_show_is_seen_by_its_octave(drawing):
    """Dents of half a degree, 32 texels apart, in place of nothing."""
    lesson = Teacher.of(drawing, 64, 99).lesson(3)
    flat = replace(lesson.maps, height=torch.zeros_like(lesson.maps.height))
    waves = torch.sin(math.tau * torch.arange(64.0) / 32.0).expand(1, 1, 64, 64)
    dents = replace(flat, height=0.07 * waves * flat.texel_size)
    taught = replace(lesson, maps=flat)
    assert float(taught.loss(flat)) == pytest.approx(0.0, abs=1e-5)
    assert float(taught.loss(dents)) > 0.1  # 0.03 by radiance alone


def test_clouds_larger_than_a_window_are_seen_in_fine_tuning(drawn, drawing):
    """Two windows that differ in their mean: AdaIN removes it, and frozen statistics do not."""
    tuned = drawn.part(TunedDecoder)
    decoder, area = tuned.decoder, Rectangle(0, 0, 128, 128)
    noise = random_field(Patch(1, area, period=(128, 128)), SMALL.noise_channels, (), levels=DEPTH)
    field = replace(noise, drawing=drawing.levels(1, area, (128, 128)))
    moved = ([level + offset for level in field.drawing] for offset in (0.7, -0.7))
    bright, dark = (replace(field, drawing=tuple(levels)) for levels in moved)

    def contrast(decode):
        return (decode(bright) - decode(dark)).mean((0, 2, 3))

    with torch.no_grad():
        assert contrast(lambda one: decoder(one, CODE)).abs().max() < 1e-3
        wanted = contrast(lambda one: decoder(one, CODE, tuned.moments))
        windows = Renormalisation()
        for share in (0.0, *[1.0] * 20):
            found = contrast(lambda one, share=share: windows.decode(decoder, one, CODE, share))
            assert share or found.abs().max() < 1e-3
    assert _correlation(found, wanted) > 0.95 and float(found.norm() / wanted.norm()) > 0.5


def _correlation(first, second):
    return float(torch.corrcoef(torch.stack([first.flatten(), second.flatten()]))[0, 1])


def test_the_file_has_the_exemplar_and_says_so(drawn, tmp_path, capsys):
    path = tmp_path / "drawn.matcap"
    drawn.save(path)
    loaded = Material.load(path)
    assert set(loaded.generators) == {"decoder"}
    kept = loaded.part(TunedDecoder).drawing.example.exemplar.stacked()
    assert (kept == drawn.part(TunedDecoder).drawing.example.exemplar.stacked()).all()
    assert main(["inspect", str(path)]) == 0
    said = capsys.readouterr().out
    assert "a decoder that reads a drawing" in said and "176 x 144 texels" in said


@pytest.mark.parametrize("channels", [1, -2])
def test_a_file_with_another_drawing_is_refused(tmp_path, monkeypatch, drawn, channels):
    arrays, about = drawn.part(TunedDecoder).in_file()
    about["decoder"]["drawing"] = channels
    monkeypatch.setattr(TunedDecoder, "in_file", lambda self, by_example: (arrays, about))
    drawn.save(tmp_path / "m.matcap")
    with pytest.raises(MatcapError, match="channels of a drawing"):
        Material.load(tmp_path / "m.matcap")


def test_the_middle_of_two_draws_what_lies_between(drawn, tmp_path, capsys):
    second = a_material("bricks", seed=8, config=SMALL, drawing=Drawing(Example.of(bricks())))
    middle = blend(drawn, second, 0.25).part(TunedDecoder)
    one, other = (each.part(TunedDecoder).drawing.example.exemplar for each in (drawn, second))
    wanted = interpolated(one, other, 0.25).rounded()
    assert (middle.drawing.example.exemplar.stacked() == wanted.stacked()).all()
    assert middle.texel_size == middle.drawing.example.exemplar.texel_size
    assert blend(drawn, second, 0.0) is drawn and blend(drawn, second, 1.0) is second
    for name, material in (("a", drawn), ("b", second)):
        material.save(tmp_path / f"{name}.matcap")
    ends = [str(tmp_path / name) for name in ("a.matcap", "b.matcap")]
    assert main(["blend", *ends, "-t", "0:1:2", "-o", str(tmp_path / "out")]) == 0
    assert "patterns" not in capsys.readouterr().err


def test_one_that_draws_blends_with_one_that_does_not(drawn, drawing):
    plain = a_material("plain", seed=8, config=SMALL)
    for ends, share in (((drawn, plain), 0.01), ((plain, drawn), 0.99)):
        middle = blend(*ends, share)
        assert middle.part(TunedDecoder).drawing is drawing
        one, other = (quick_maps(each, 64, 64).stacked()[:5] for each in (middle, drawn))
        assert float((one - other).abs().mean()) < 0.02


@pytest.fixture(scope="module")
def example():
    return Example.of(blobs(352, 288))


@pytest.mark.parametrize("turned", [False, True])
def test_beside_an_exemplar_it_draws_from_that(tmp_path, example, turned):
    """One file, one exemplar: the decoder's texels are means of its texels, of the same field."""
    drawing = Drawing(example, finer=2, turned=turned)
    alone = a_material("both", config=SMALL, drawing=drawing)
    setup = replace(alone.setup, turned=turned)
    tuned = replace(alone.part(TunedDecoder), texel_size=drawing.texel_size, turned=turned)
    parts = {"example": example, "decoder": tuned}
    both = Material("both", parts, example.texel_size, setup).preferring("decoder")
    both.save(tmp_path / "both.matcap")
    loaded = Material.load(tmp_path / "both.matcap")
    assert loaded.made_by == "decoder" and loaded.texel_size == 2 * example.texel_size
    read = loaded.part(TunedDecoder).drawing
    assert read.example is loaded.part(Example) and (read.finer, read.turned) == (2, turned)
    place = {"seed": 3, "x": 16, "y": -32}
    one, other = (quick_maps(each, 64, 48, **place) for each in (both, loaded))
    assert torch.equal(one.stacked(), other.stacked())
    fine = loaded.by("example")
    assert fine.texel_size == example.texel_size and fine.made_by == "example"
    # The drawing is that of the field by example, wherever it is read.
    seen = torch.from_numpy(example.maps(3, Rectangle(-64, 96, 192, 128), None))
    halved = torch.nn.functional.avg_pool2d(seen, 2)
    area = Rectangle(-32, 48, 96, 64).grown(-AROUND)
    lying = Rectangle(area.y, -area.x - area.width, area.height, area.width) if turned else area
    drawn = drawing.around(3, lying)
    assert torch.equal(drawn.rot90(-1, (1, 2)) if turned else drawn, halved)
    fine.save(tmp_path / "a")
    both.by("decoder").save(tmp_path / "b")
    size, *apart = ((tmp_path / name).stat().st_size for name in ("both.matcap", "a", "b"))
    assert size < sum(apart)
    alone = Material.load(tmp_path / "b")
    assert torch.equal(quick_maps(alone, 64, 48, **place).stacked(), one.stacked())


def test_a_decoder_is_not_read_without_the_exemplar_that_it_draws_from(
    tmp_path, monkeypatch, example
):
    alone = a_material("both", config=SMALL, drawing=Drawing(example, finer=2))
    both = replace(alone, generators={"example": example, **alone.generators})
    monkeypatch.setattr(Example, "in_file", lambda self, by_example=None, entry="example": ({}, {}))
    both.save(tmp_path / "m.matcap")
    with pytest.raises(MatcapError, match="draws from is missing"):
        Material.load(tmp_path / "m.matcap")
