"""Blending: ends are the ends, the middle lies between, and the commands write what they say."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from example.exemplars import PERIODS, blobs, bricks
from materials import a_material

from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.example.interpolate import interpolated
from matcap.field.material import Material
from matcap.space.between import blend, blend_waves
from matcap.space.decoder import Decoder, DecoderConfig
from matcap.space.freeze import freeze
from matcap.space.lattice_channels import CELL_CHANNELS
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.start import reading_cells
from matcap.statistics.lattice import Wave


def test_the_ends_are_the_materials_themselves(prior):
    a, b = prior.draw(1), prior.draw(2)
    assert blend(a, b, 0.0) is a
    assert blend(a, b, 1.0) is b


def test_near_an_end_it_looks_like_that_end(prior):
    a, b = prior.draw(1), prior.draw(2)
    first, last = (m.maps(64, 64).stacked()[:5] for m in (a, b))
    distances = []
    for share in (0.01, 0.25, 0.5, 0.75, 0.99):
        found = blend(a, b, share).maps(64, 64).stacked()[:5]
        distances.append((float((found - first).abs().mean()), float((found - last).abs().mean())))
    from_a, from_b = zip(*distances, strict=True)
    assert list(from_a) == sorted(from_a)
    assert list(from_b) == sorted(from_b, reverse=True)
    assert from_a[0] < 0.05 * from_a[-1]


def test_the_middle_has_the_mean_weights_and_its_own_moments(prior):
    ends = prior.draw(1), prior.draw(2)
    a, b, middle = (m.part(TunedDecoder) for m in (*ends, blend(*ends, 0.5)))
    name = "head.adain.affine.bias"
    wanted = (a.decoder.state_dict()[name] + b.decoder.state_dict()[name]) / 2
    torch.testing.assert_close(middle.decoder.state_dict()[name], wanted)
    torch.testing.assert_close(middle.code, (a.code + b.code) / 2)
    assert not torch.equal(middle.moments[0][0], a.moments[0][0]) or not torch.equal(
        middle.moments[-1][0], a.moments[-1][0]
    )


def test_stripes_told_backwards_are_the_same_stripes():
    wave, backwards = Wave(0.1, 0.02), Wave(-0.1, -0.02)
    assert blend_waves((wave,), (backwards,), 0.5) == (wave,)
    assert blend_waves((wave,), (), 0.4) == (wave,)
    assert blend_waves((wave,), (), 0.6) == ()


def test_a_material_without_order_blends_with_one_that_has_cells(prior):
    a, b = prior.draw(1), prior.draw(2)
    tuned = b.part(TunedDecoder)
    decoder, waves = reading_cells(tuned.decoder, 0), (Wave(1 / 20, 0.0),)
    moments = tuple(freeze(decoder, tuned.code, waves))
    ordered = replace(tuned, decoder=decoder, waves=waves, moments=moments)
    ordered = ordered.material("ordered", b.setup)
    for first, second in ((a, ordered), (ordered, a)):
        mostly_ordered = blend(first, second, 0.9 if second is ordered else 0.1)
        made = mostly_ordered.part(TunedDecoder)
        assert made.waves == waves
        assert made.decoder.config.cells == CELL_CHANNELS
        assert torch.isfinite(mostly_ordered.maps(64, 64).stacked()).all()


def test_what_cannot_be_blended_is_refused(prior):
    a = prior.draw(1)
    with pytest.raises(UsageError, match="not between 0 and 1"):
        blend(a, a, 1.5)
    wider = Decoder(DecoderConfig(4, (8, 8, 8, 8, 16), (1, 1)))
    tuned = replace(a.part(TunedDecoder), decoder=wider, waves=())
    b = tuned.material("b", a.setup)
    with pytest.raises(MatcapError, match="different shapes"):
        blend(a, b, 0.5)


def test_the_command_writes_materials_and_a_strip(prior, tmp_path, capsys):
    folder, out = tmp_path / "a", tmp_path / "out"
    folder.mkdir()
    a, b = folder / "a.matcap", tmp_path / "b.matcap"
    for seed, path in ((1, a), (2, b)):
        prior.draw(seed).save(path)
    assert main(["blend", str(folder), str(b), "-t", "0:1:3", "-o", str(out)]) == 0
    assert capsys.readouterr().err.count("not their patterns") == 1
    assert sorted(p.name for p in out.iterdir()) == [
        "a_b_0.000.matcap",
        "a_b_0.500.matcap",
        "a_b_1.000.matcap",
        "strip.png",
    ]
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


def test_a_lattice_is_found_again_and_patches_keep_to_it():
    wall, spots = bricks(400, 320), Example.of(blobs(400, 320))
    wall = Example.of(replace(wall, diffuse=wall.roughness.repeat(3, axis=0)))  # of one colour
    ends = [a_material(example=example).by("example") for example in (wall, spots)]
    found = blend(*ends, 0.1).part(Example).index.lattice
    rows = [np.hypot(*wave) for wave in found.waves]
    assert np.abs(np.subtract.outer(rows, 1.0 / np.array(PERIODS))).min() < 1e-3


def test_setups_of_a_portrait_and_a_landscape_keep_the_nearer_ones_geometry():
    example = Example.of(blobs())
    lying = a_material("lying", example=example).by("example")
    standing = replace(
        lying,
        setup=replace(lying.setup, turned=True, tilt=(0.1, 0.0), intensity=(3.0, 3.0, 3.0)),
    )
    assert blend(lying, standing, 0.25).setup == lying.setup.with_intensity((1.5, 1.5, 1.5))
    assert blend(lying, standing, 0.75).setup == standing.setup.with_intensity((2.5, 2.5, 2.5))


@pytest.mark.parametrize("share", ["2", "0:1", "0:1:1", "a", "-1", "0:2:3"])
def test_a_share_that_is_none_is_a_usage_error(tmp_path, share, capsys):
    assert main(["blend", "a", "b", f"-t={share}"]) == 2


def test_samples_are_drawn_from_a_given_prior(prior, tmp_path, capsys):
    prior.save(tmp_path / "p.safetensors")
    out = tmp_path / "s.png"
    arguments = ["sample", "-n", "3", "--prior", str(tmp_path / "p.safetensors"), "-o", str(out)]
    assert main(arguments) == 0
    assert out.stat().st_size > 1000
    assert main(["sample", "--prior", str(tmp_path / "none"), "-o", str(out)]) == 3


def test_the_shipped_prior_loads_and_draws():
    from matcap.space.prior.store import SHIPPED, load_prior

    assert SHIPPED.stat().st_size < 30e6
    prior = load_prior()
    assert SHIPPED.with_suffix(".md").is_file()
    assert prior.anchors is not None and len(prior.anchors) == 346
    maps = prior.draw(0).maps(32, 32).stacked()
    assert bool(torch.isfinite(maps).all())
    mean = torch.tensor(prior.about["code_mean"])
    variance = torch.tensor(prior.about["code_variance"])
    assert float(mean.abs().max()) < 0.05 and float((variance - 1).abs().max()) < 0.05


def test_synth_without_a_material_draws_one(tmp_path, capsys):
    out = tmp_path / "maps"
    assert main(["synth", "--size", "96x32", "--seed", "7", "-o", str(out)]) == 0
    assert (out / "drawn_7.json").is_file()
    assert main(["synth", "--size", "32", "--seed", "-3", "-o", str(tmp_path / "more")]) == 0
