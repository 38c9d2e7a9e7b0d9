"""Training: it learns, and a killed run goes on as if nothing had happened."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from packs import entry
from safetensors.torch import load_file, save_file
from small import SMALL

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError, UsageError
from matcap.flash.alignment import PICTURE_CHANNELS
from matcap.flash.coarse.fit import fit_coarse
from matcap.space.decoder import DecoderConfig
from matcap.space.encoder import FEATURES, NUMBERS, TEXTURE, Encoder, EncoderConfig
from matcap.space.prior.store import base_of, fold, load_prior
from matcap.statistics.compare import Encoding, FilterBank
from matcap.statistics.lattice import Wave
from matcap_lab.cli.main import main
from matcap_lab.train import corpus as pictures
from matcap_lab.train.corpus import Pack, first_of_each, simulate, true_piece
from matcap_lab.train.evaluate import VarietySettings, middles, run_variety
from matcap_lab.train.step import (
    TrainConfig,
    Turn,
    comb,
    cut,
    prepare,
    relief_distance,
    relit_distance,
    side_light,
    start_head,
)
from matcap_lab.train.trainer import Training
from matcap_lab.train.training import draw, read_config, schedule, train

TINY = TrainConfig(
    steps=4,
    materials=1,
    places=1,
    window=64,
    report_every=2,
    rate=1e-3,
    encoder=EncoderConfig(width=64),
    decoder=DecoderConfig(noise_channels=4, widths=(8, 8, 8, 8, 8), convolutions=(1, 1)),
)


def weights(state):
    return {k: v.clone() for k, v in state.model.state_dict().items()} | {
        f"average {k}": v.clone() for k, v in state.average.state_dict().items()
    }


def curves(folder):
    with (folder / "curves.csv").open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def test_a_resumed_run_ends_with_the_same_bits(small_pack, tmp_path):
    config = replace(TINY, checkpoint_minutes=0.0)
    whole = train(small_pack, config, tmp_path / "whole")

    class Killed(Exception):
        pass

    def kill(line):
        raise Killed

    with pytest.raises(Killed):  # after step 2 is reported, before its checkpoint: step 1 is kept
        train(small_pack, config, tmp_path / "parts", on_progress=kill)
    resumed = train(small_pack, config, tmp_path / "parts", resume=True)
    assert resumed.step == whole.step == 4
    for name, value in weights(whole).items():
        assert torch.equal(value, weights(resumed)[name]), name
    assert [row["step"] for row in curves(tmp_path / "parts")] == [2, 4]
    assert (tmp_path / "parts" / "sheet.png").is_file()


def test_curves_of_an_older_version_are_gone_on_with(small_pack, tmp_path):
    """Before the second teacher they had a column less."""
    train(small_pack, replace(TINY, steps=2), tmp_path)
    rows = curves(tmp_path)
    names = [name for name in rows[0] if name != "relit"]
    with (tmp_path / "curves.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    train(small_pack, TINY, tmp_path, resume=True)
    train(small_pack, replace(TINY, steps=6), tmp_path, resume=True)
    assert [row["step"] for row in curves(tmp_path)] == [2, 4, 6]


def test_a_leg_goes_on_from_a_priors_networks(small_pack, tmp_path):
    """What is shipped can be trained on: the first step begins where it stands."""
    config = replace(TrainConfig(), steps=1, materials=1, places=1, window=64, rate=1e-5)
    config = replace(config, encoder_rate=1e-5, average=0.0, kl_warmup=1)
    prior = load_prior()
    trained = train(small_pack, config, tmp_path, prior=prior).model
    for name in ("encoder", "decoder"):
        before, after = getattr(prior, name).state_dict(), getattr(trained, name).state_dict()
        moved = max(float((after[k] - before[k]).abs().max()) for k in before)
        assert 0.0 < moved < 2e-5, name  # one step of AdamW at that rate


def test_a_prior_of_another_shape_is_refused(small_pack, tmp_path):
    with pytest.raises(UsageError, match="encoder is of another shape") as error:
        train(small_pack, TINY, tmp_path / "run", prior=load_prior())
    assert error.value.where == "--start"
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_of_another_shape_names_the_tensor(small_pack, tmp_path):
    train(small_pack, replace(TINY, steps=1), tmp_path)
    other = replace(TINY, decoder=replace(TINY.decoder, widths=(8, 8, 8, 8, 16)))
    with pytest.raises(MatcapError, match=r"tensor 'model\.decoder\..*' should be"):
        train(small_pack, other, tmp_path, resume=True)


def test_a_broken_or_foreign_checkpoint_is_refused(small_pack, tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    with pytest.raises(MatcapError, match="no such checkpoint"):
        train(small_pack, TINY, tmp_path, resume=True)
    save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(MatcapError, match="not a checkpoint of version"):
        train(small_pack, TINY, tmp_path, resume=True)
    train(small_pack, replace(TINY, steps=1), tmp_path)
    tensors = load_file(path)
    tensors.pop("optimiser.exp_avg.encoder.head.bias")
    save_file(tensors, path, {"format": "matcap-checkpoint", "version": "2", "step": "1"})
    with pytest.raises(MatcapError, match="optimiser.exp_avg.encoder.head.bias"):
        train(small_pack, TINY, tmp_path, resume=True)


def test_training_lowers_the_loss(small_pack, tmp_path):
    train(small_pack, replace(TINY, steps=16, report_every=8, average=0.5, rate=5e-3), tmp_path)
    style = [row["style"] for row in curves(tmp_path)]
    assert style[-1] < 0.95 * style[0]


def test_held_out_materials_are_never_drawn(pack):
    assert len(pack.reserved) == 12
    rng = np.random.default_rng(0)
    drawn = {e.material for _ in range(50) for e in draw(pack.training, TINY, rng)}
    assert drawn == {e.material for e in pack.training}
    assert not drawn & pack.reserved


def test_the_rate_warms_up_stays_and_falls():
    rates = [schedule(1000).share(step) for step in range(1000)]
    assert rates[0] < 0.05
    assert rates[100] == rates[700] == 1.0
    assert rates[999] < 0.05


@pytest.mark.parametrize(
    "text, message",
    [
        ("stepz = 3", "no setting 'stepz'"),
        ("steps = 'many'", "'steps' is 'many'"),
        ("steps = 3.5", "'steps' is 3.5"),
        ("window = 100", "window 100"),
        ("steps =", "not TOML"),
    ],
)
def test_a_wrong_configuration_is_told(tmp_path, text, message):
    path = tmp_path / "train.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        read_config(path)


def test_a_configuration_is_read(tmp_path):
    path = tmp_path / "train.toml"
    path.write_text("steps = 7\nrate = 1\n[encoder]\nwidth = 512\n")
    config = read_config(path)
    assert (config.steps, config.rate) == (7, 1.0)
    assert config.encoder == EncoderConfig(512)


def encoded(encoder):
    """Of two random photographs."""
    return encoder(
        torch.randn(2, PICTURE_CHANNELS, 48, 64), torch.randn(2, NUMBERS), torch.randn(2, TEXTURE)
    )


def test_an_encoder_learns():
    """One step of Adam on a small picture moves every weight, and none of them to NaN."""
    torch.manual_seed(0)
    encoder = Encoder(EncoderConfig(width=64))
    optimiser = torch.optim.Adam(encoder.parameters(), lr=1e-4)
    before = {name: value.clone() for name, value in encoder.state_dict().items()}
    mean, log_variance = encoded(encoder)
    kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()
    (kl + (mean - 1.0).square().mean()).backward()
    optimiser.step()
    for name, value in encoder.state_dict().items():
        assert bool(torch.isfinite(value).all()), name
        assert not torch.equal(value, before[name]), name


def test_a_loss_without_a_gradient_moves_nothing_but_the_step():
    network = torch.nn.Linear(2, 1)
    training = Training(network, {"": 0.1}, decay=0.5)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    training.update((network(torch.ones(2)) * torch.inf).sum(), 1.0)
    assert training.step == 1
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())
    training.update(network(torch.ones(2)).sum(), 1.0)
    assert not torch.equal(network.weight, before["weight"])


def test_the_average_follows_by_its_decay_and_rates_go_by_name():
    network = torch.nn.Sequential(torch.nn.Linear(2, 2), torch.nn.Linear(2, 1))
    training = Training(network, {"0.": 0.5, "1.": 0.0}, decay=0.25)
    for _ in range(40):  # until the decay is its own
        before = training.average[0].weight.clone()
        training.update(network(torch.ones(2)).square().sum(), 1.0)
    expected = 0.25 * before + 0.75 * network[0].weight
    torch.testing.assert_close(training.average[0].weight, expected)
    assert torch.equal(training.average[1].weight, network[1].weight)


def test_the_page_tells_what_was_measured(prior, pack, tmp_path, monkeypatch):
    pack = Pack((*pack.entries, *(entry(f"simulated{i}", i, simulated=True) for i in range(4))))
    monkeypatch.setattr(pictures, "SIZE", 64)
    monkeypatch.setattr("matcap_lab.train.corpus.LONG_SIDE", 256)
    monkeypatch.setattr("matcap_lab.train.evaluate.PAIRS", 2)
    said = []
    settings = VarietySettings(draws=16, simulated=5)
    page = run_variety(prior, pack, settings, tmp_path, "matcap-lab prior variety", said.append)
    assert page == (tmp_path / "prior-variety.md").read_text()
    assert "| all | draws |" in page and "| simulated | training photographs |" in page
    assert page.count(" and m") == 2
    assert (tmp_path / "prior-variety.jpg").stat().st_size > 1000
    assert (tmp_path / "prior-blends.jpg").stat().st_size > 1000
    assert said[-1] == "16 of 16 draws"


def test_pictures_are_brought_to_the_same_radiance(prior, pack):
    from matcap.files.color import srgb_decode

    shown = [pictures.middle(pack.entries[0]), pictures.lit(prior.draw(0))]
    means = [float(srgb_decode(picture.numpy()).mean()) for picture in shown]
    assert all(abs(mean - 0.25) < 0.03 for mean in means)


def test_a_photograph_itself_is_no_distance_away(prior, pack, monkeypatch):
    """Ends that are among the photographs leave the middle to be told alone."""
    from matcap_lab.measures.style import describe_pictures

    monkeypatch.setattr(pictures, "SIZE", 64)
    entries = first_of_each(pack.reporting)[:2]
    ends = [prior.draw(0, near=prior.place(e.photo()), spread=0.0) for e in entries]
    ((row, _),) = middles(prior, entries, describe_pictures([pictures.lit(end) for end in ends]))
    assert row.number("ends") < 1e-6 < row.number("middle")
    assert row.subject == f"{entries[0].material} and {entries[1].material}"


def test_the_command_refuses_a_pack_that_is_none(tmp_path, capsys):
    assert main(["prior", "variety", str(tmp_path / "absent.pack"), "-o", str(tmp_path)]) == 3
    assert "there is no such pack" in capsys.readouterr().err


# Augmentation keeps the geometry true: a turned photograph is the photograph of a turned scene.

TURNS = [Turn(mirrored, quarters) for mirrored in (False, True) for quarters in range(4)]


@pytest.fixture(scope="module")
def source(pack):
    return prepare(pack.entries[-1], 64)


@pytest.mark.parametrize("turn", TURNS)
def test_a_vector_moves_as_the_picture_does(turn):
    """The brightest texel lies where its position vector was turned to."""
    picture = torch.zeros(9, 9)
    picture[1, 6] = 1.0
    row, column = divmod(int(turn.image(picture).argmax()), 9)
    found = turn.vector(torch.tensor([2.0, 3.0]))  # texel (6, 1) about the middle, y upwards
    assert (column - 4, 4 - row) == tuple(found.int().tolist())


@pytest.mark.parametrize("turn", TURNS)
def test_a_wave_moves_as_the_picture_does(turn):
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")

    def stripes(wave: Wave) -> torch.Tensor:
        return torch.fft.fft2(torch.cos(2 * torch.pi * (wave.fx * columns + wave.fy * rows))).abs()

    wave = Wave(3 / 32, 5 / 32)
    picture = torch.cos(2 * torch.pi * (wave.fx * columns + wave.fy * rows))
    turned = torch.fft.fft2(turn.image(picture)).abs()
    torch.testing.assert_close(turned, stripes(turn.wave(wave)), atol=1e-2, rtol=0)


@pytest.mark.parametrize("turn", TURNS)
def test_a_flat_material_renders_the_same_turned(source, turn):
    """Points, lights and vignetting turn together: rendering and turning commute."""
    flat = torch.full((1, 1, 48, 48), 0.4)
    maps = MapSet(flat.expand(1, 3, -1, -1), 0.1 * flat, flat, 0.0 * flat, 2.0 / 1024)
    plain = cut(source, 48, 2, 1, Turn(), np.random.default_rng(1), augment=False)
    turned = cut(source, 48, 2, 1, turn, np.random.default_rng(1), augment=False)
    torch.testing.assert_close(turned.render(maps), turn.image(plain.render(maps)))
    torch.testing.assert_close(turned.linear, turn.image(plain.linear))


def test_colours_and_base_are_permuted_together(source):
    plain = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4), augment=False)
    changed = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4))
    ratio = (changed.linear / changed.linear.sum(1, keepdim=True)).mean((0, 2, 3))
    order = ratio.argsort()
    assert torch.equal(order, changed.base.mean[:3].argsort())
    assert torch.equal(order, changed.numbers[:3].argsort())
    assert not torch.equal(plain.numbers, changed.numbers)


def test_the_encoding_follows_the_permutation(source):
    """What is compared stays the same but for a white balance of at most 15 percent."""
    plain = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4), augment=False)
    changed = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4))
    found, wanted = changed.encoding(changed.linear), plain.encoding(plain.linear)
    assert bool(((found - wanted).std(dim=(2, 3)) < 0.1 * wanted.std(dim=(2, 3))).all())


def test_folding_the_base_changes_no_output(prior, pack):
    from matcap_lab.train.step import fields

    start_head(prior.decoder)
    base = base_of(pack.entries[0].coarse, torch.tensor([0.1, 0.2, 0.3]))
    field = fields(SMALL, [()], 32, 1, "cpu")
    code = torch.randn(64)
    with torch.no_grad():
        wanted = base.apply(prior.decoder(field, code))
        found = fold(prior.decoder, base)(field, code)
    torch.testing.assert_close(found, wanted, atol=1e-4, rtol=1e-4)


# The second teacher: true maps of simulated materials, and what light from the side tells.

ENCODING = Encoding(0.2, 3.0 * torch.eye(3))


@pytest.fixture(scope="module")
def simulated_entry():
    return simulate(3)


def bumps(seed: int, height: float) -> MapSet:
    generator = torch.Generator().manual_seed(seed)
    noise = F.avg_pool2d(torch.randn(1, 1, 164, 164, generator=generator), 5, 1)
    grey = torch.full((1, 1, 160, 160), 0.3)
    texel = 2.0 / 1024
    return MapSet(grey.expand(1, 3, -1, -1), 0.1 * grey, 2.0 * grey, height * texel * noise, texel)


def apart(found: MapSet, truth: MapSet, seed: int = 0) -> float:
    light = side_light(np.random.default_rng(seed))
    return float(relit_distance(found, truth, light, ENCODING, FilterBank(FEATURES)))


def test_a_side_light_is_far_and_slanting():
    lights = torch.stack([side_light(np.random.default_rng(seed)) for seed in range(200)])
    angle = torch.rad2deg(torch.acos(lights[:, 2] / lights.norm(dim=1)))
    assert 29.9 < float(angle.min()) < 35.0 and 65.0 < float(angle.max()) < 70.1
    assert float((lights[:, :2] / lights[:, :2].norm(dim=1, keepdim=True)).mean(0).norm()) < 0.2


def test_truth_is_nearest_and_flatness_far():
    truth = bumps(1, 4.0)
    assert apart(truth, truth) == 0.0
    other, flat, deep = (apart(bumps(2, h), truth) for h in (4.0, 0.0, 16.0))
    assert other < 0.6 * flat and other < 0.3 * deep


def test_how_bright_a_surface_is_is_not_asked_for():
    truth = bumps(1, 4.0)
    darker = replace(truth, diffuse=truth.diffuse / 4.0, specular=truth.specular / 4.0)
    assert apart(darker, truth) < 0.15 * apart(bumps(1, 0.0), truth)


def test_relief_is_compared_octave_by_octave():
    truth = bumps(1, 4.0)
    assert float(relief_distance(truth, truth)) == 0.0
    assert float(relief_distance(bumps(2, 4.0), truth)) < 0.2
    doubled = float(relief_distance(bumps(1, 8.0), truth))
    assert 0.9 < doubled / (2.0 * np.log(2.0)) < 1.0  # unseen slopes count as equal
    fine = bumps(1, 0.0)
    noise = torch.randn(fine.height.shape, generator=torch.Generator().manual_seed(3))
    squared = (truth.height / truth.texel_size).diff(dim=-1).square().mean()
    rough = replace(fine, height=(squared / 2.0).sqrt() * fine.texel_size * noise)
    assert float(relief_distance(rough, truth)) > 0.4  # as steep at its finest, not beyond


def test_a_comb_is_seen_though_no_normal_shows_it():
    truth = bumps(1, 4.0)
    assert float(comb(truth)) == 0.0  # five texels wide
    columns = torch.arange(truth.height.shape[-1]) % 2
    combed = replace(truth, height=truth.height + 2.0 * truth.texel_size * columns)
    assert float((combed.normal - truth.normal).abs()[..., 1:-1].max()) < 1e-5
    assert float(comb(combed)) > 0.8
    assert float(relief_distance(combed, truth)) > 0.2


def test_relief_is_told_which_way_to_go():
    truth, height = bumps(1, 4.0), torch.tensor(1.0, requires_grad=True)
    plain = bumps(2, 1.0)
    found = replace(plain, height=plain.height * height)
    light = side_light(np.random.default_rng(0))
    relit_distance(found, truth, light, ENCODING, FilterBank(FEATURES)).backward()
    assert height.grad is not None and float(height.grad) < 0.0


def test_a_simulated_photographs_maps_are_of_what_it_shows(simulated_entry):
    """The hue of their mean albedo is what a fit under the simulated white flash finds."""
    maps = true_piece(simulated_entry, 512)
    assert maps is not None and maps.size == (512, 512)
    mean = maps.diffuse.double().mean((1, 2))
    white = fit_coarse(replace(simulated_entry.photo(), flash_intensity=1.0))
    assert torch.allclose(mean / mean.sum(), hue(white.diffuse), atol=0.03)


def hue(diffuse) -> torch.Tensor:
    colour = torch.tensor(diffuse, dtype=torch.float64)
    return colour / colour.sum()


def test_real_photographs_have_no_truth_and_strange_ones_are_refused(pack, simulated_entry):
    assert true_piece(pack.entries[0], 64) is None
    for strange in (
        replace(simulated_entry, tilt=(0.2, 0.1)),
        replace(simulated_entry, name="simulated_x"),
    ):
        with pytest.raises(MatcapError, match="another version") as error:
            true_piece(strange, 64)
        assert error.value.where == strange.name


@pytest.mark.parametrize("quarters", range(4))
def test_true_windows_turn_with_the_photographs(simulated_entry, quarters):
    source = prepare(simulated_entry, 64, true_piece(simulated_entry, 128))
    turn = Turn(True, quarters)
    plain = cut(source, 64, 1, 2, Turn(), np.random.default_rng(1), augment=False).truth
    turned = cut(source, 64, 1, 2, turn, np.random.default_rng(1), augment=False).truth
    assert plain is not None and turned is not None
    assert torch.equal(turned.height, turn.image(plain.height))
    assert turned.texel_size == 2.0 * 2.0 / 1024


def test_training_listens_to_it(small_pack, simulated_entry, tmp_path):
    """The same run with and without it ends elsewhere, and says how far the truth is."""
    real = tuple(e for e in small_pack.entries if not e.simulated)
    pack = replace(small_pack, entries=(*real, simulated_entry))
    config = TrainConfig(
        steps=1, materials=1, places=1, window=64, report_every=1, real_share=0.0, relit=1.0
    )
    ends = [
        train(pack, replace(config, relit=relit), tmp_path / f"{relit}").model.decoder.state_dict()
        for relit in (0.0, 1.0)
    ]
    assert any(not torch.equal(ends[0][name], ends[1][name]) for name in ends[0])
    for relit in (0.0, 1.0):
        with (tmp_path / f"{relit}" / "curves.csv").open() as file:
            (row,) = csv.DictReader(file)
        assert (float(row.get("relit", 0.0)) > 0.0) == bool(relit)
