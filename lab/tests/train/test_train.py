"""Training: it learns, and a killed run goes on as if nothing had happened."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
from packs import entry
from safetensors.torch import load_file, save_file

from matcap.errors import MatcapError, UsageError
from matcap.space.decoder import DecoderConfig
from matcap.space.encoder import NUMBERS, PICTURE_CHANNELS, TEXTURE, Encoder, EncoderConfig
from matcap.space.prior.store import load_prior
from matcap_lab.cli.main import main
from matcap_lab.train import corpus as pictures
from matcap_lab.train.corpus import Pack, first_of_each
from matcap_lab.train.evaluate import VarietySettings, middles, run_variety
from matcap_lab.train.step import TrainConfig
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
    config = replace(TINY, steps=16, report_every=8, average=0.5, rate=5e-3)
    train(small_pack, config, tmp_path)
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
        ("[encoder]\nbackbone = 'vit'", "no backbone 'vit'"),
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
    path.write_text("steps = 7\nrate = 1\n[encoder]\nbackbone = 'resnet50'\nwidth = 512\n")
    config = read_config(path)
    assert (config.steps, config.rate) == (7, 1.0)
    assert config.encoder == EncoderConfig("resnet50", 512)


def encoded(encoder):
    """Of two random photographs."""
    return encoder(
        torch.randn(2, PICTURE_CHANNELS, 48, 64), torch.randn(2, NUMBERS), torch.randn(2, TEXTURE)
    )


def test_both_backbones_have_one_interface():
    for backbone, least in (("small", 1e6), ("resnet50", 2e7)):
        encoder = Encoder(EncoderConfig(backbone))
        assert sum(p.numel() for p in encoder.parameters()) > least
        with torch.no_grad():
            mean, log_variance = encoded(encoder)
        assert mean.shape == log_variance.shape == (2, 64)


def test_the_papers_backbone_learns():
    """One step of Adam on a small picture moves every weight, and none of them to NaN."""
    torch.manual_seed(0)
    encoder = Encoder(EncoderConfig("resnet50", width=64))
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
    from matcap.files.srgb import srgb_decode_tensor

    shown = [pictures.middle(pack.entries[0]), pictures.lit(prior.draw(0))]
    means = [float(srgb_decode_tensor(picture).mean()) for picture in shown]
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
