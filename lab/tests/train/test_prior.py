"""The corpus: a folder with bad pictures, the pack's file, and the rule of holding out."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from packs import jpeg
from small import SMALL

from matcap.errors import MatcapError
from matcap.flash.alignment import load_alignment, save_alignment
from matcap.space.prior import SHIPPED
from matcap.space.prior.store import base_of, load_prior
from matcap.space.tuning.finetune import Tuned
from matcap_lab.experiment.runner import Configuration
from matcap_lab.simulate.kinds import RandomKind
from matcap_lab.train import evaluate
from matcap_lab.train.alignment import train_branch
from matcap_lab.train.corpus import Pack, build, held_out, material_of, simulate
from matcap_lab.train.evaluate import SIZE, Made, capture, compared, photographed
from matcap_lab.train.finish import codes_of, finish, standardise, with_anchors
from matcap_lab.train.step import fields
from matcap_lab.train.training import read_config


def test_unreadable_pictures_are_listed_and_left_out(pack, tmp_path):
    (tmp_path / "a_1.jpg").write_bytes(pack.entries[0].jpeg)
    (tmp_path / "b_1.jpg").write_bytes(b"not a picture")
    (tmp_path / "c_1.jpg").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("no picture either")
    packed, skipped = build(tmp_path, 0)
    assert [e.material for e in packed.entries] == ["a"]
    assert [name for name, _ in skipped] == ["b_1.jpg", "c_1.jpg"]


def test_a_folder_without_pictures_is_an_error(tmp_path):
    with pytest.raises(MatcapError, match="no picture could be used"):
        build(tmp_path, 0)
    with pytest.raises(MatcapError, match="no such folder"):
        build(tmp_path / "absent", 0)


def test_a_pack_comes_back(pack, tmp_path):
    path = tmp_path / "corpus.pack"
    pack.save(path)
    again = Pack.load(path)
    for found, wanted in zip(again.entries, pack.entries, strict=True):
        assert (found.name, found.jpeg, found.coarse) == (wanted.name, wanted.jpeg, wanted.coarse)
        assert (found.waves, found.tilt, found.simulated) == (
            wanted.waves,
            wanted.tilt,
            wanted.simulated,
        )
    assert again.reserved == pack.reserved


def test_what_is_no_pack_is_refused(tmp_path):
    path = tmp_path / "pack"
    with pytest.raises(MatcapError, match="no such pack"):
        Pack.load(path)
    path.write_bytes(b"\0" * 64)
    with pytest.raises(MatcapError, match="cannot be read"):
        Pack.load(path)
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(MatcapError, match="not a pack of version"):
        Pack.load(path)


def test_holding_out_depends_on_names_alone():
    names = [f"{n:04d}" for n in range(77)]
    chosen = held_out(names)
    assert len(chosen) == 12
    assert chosen == held_out(list(reversed(names)) + names)
    # Leaving out a material that was not chosen changes nothing.
    rest = [n for n in names if n in chosen or n != max(set(names) - chosen)]
    assert held_out(rest) == chosen


def test_simulated_photographs_show_things_and_patterns():
    drawn = [material_of(seed, np.random.default_rng(seed)) for seed in range(40)]
    things = [m for m in drawn if isinstance(m, RandomKind)]
    assert 16 < len(things) < 32
    assert len({m.kind for m in things}) > 10


def test_a_simulated_photograph_knows_its_tilt():
    entry = simulate(3)
    assert entry.simulated and entry.tilt is not None
    assert np.abs(entry.tilt).max() < np.radians(15.1)
    assert entry.photo().pixels.shape == (768, 1024, 3)


# A folder of photographs to a prior, end to end, and standardised codes.

CONFIG = """
steps = 2
materials = 1
places = 1
window = 64
report_every = 2
encoder = { width = 64 }
decoder = { noise_channels = 4, widths = [8, 8, 8, 8, 8], convolutions = [1, 1] }
"""


def test_commands_go_from_photographs_to_a_prior(lab, tmp_path, monkeypatch):
    photographs, config = tmp_path / "photographs", tmp_path / "train.toml"
    photographs.mkdir()
    config.write_text(CONFIG)
    monkeypatch.setattr("matcap_lab.train.corpus.HELD_OUT", 2)  # twelve take half a minute
    for index in range(3):
        (photographs / f"m{index}_a.jpg").write_bytes(jpeg(index))
    pack, run, out = tmp_path / "corpus.pack", tmp_path / "run", tmp_path / "mine.safetensors"
    packed = lab("prior", "corpus", photographs, "--simulated", 1, "-o", pack)
    assert packed.code == 0 and "4 photographs" in packed.err
    trained = ("prior", "train", pack, "--config", config, "--out", run)
    assert lab(*trained).code == lab(*trained, "--resume").code == 0
    finished = ("prior", "finish", pack, "--config", config, "--training", run, "-o", out)
    assert lab(*finished).code == 0 and load_prior(out).about["steps"] == 2


def test_the_branch_is_trained_with_its_fusion(tmp_path, monkeypatch):
    monkeypatch.setattr("matcap_lab.train.alignment._STEPS", 60)  # three thousand take five seconds
    path = tmp_path / "alignment.safetensors"
    save_alignment(path, train_branch(1, 1, fused=1))
    assert load_alignment(path) is not None


def test_the_configuration_that_comes_along_is_one():
    assert read_config(SHIPPED.parent / "train.toml").steps == 7600


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
    assert len(done.anchors) == 3


def test_draws_of_an_older_prior_are_led_to_photographs(prior, pack):
    entries = pack.entries[-3:]
    codes = codes_of(prior.encoder, entries)
    led = with_anchors(prior, entries)
    for index, entry in enumerate(entries):
        anchor = led.anchors[index]
        torch.testing.assert_close(anchor.code, codes.mean[index])
        assert len(anchor.waves) == len(entry.waves)
        base = led.conditional_mean.base(anchor.code, anchor.rest)
        wanted = base_of(entry.coarse, entry.contrast)
        torch.testing.assert_close(base.mean[:5], wanted.mean[:5], atol=1e-4, rtol=1e-4)


# Evaluation: measured once, written as a page and a picture.


@pytest.fixture(scope="module")
def shown(pack):
    return photographed(pack.reporting[0])


def test_the_photograph_itself_is_without_error(shown):
    result = compared(shown, Made(shown.truth[None], 2.0))
    assert result == {"seconds": 2.0, "style": 0.0, "XYZ": 0.0, "diversity": 0.0}


def test_the_photograph_as_albedo_is_one_picture_lit_twice(shown):
    made = evaluate.albedo(shown)
    values = compared(shown, made)
    assert values["diversity"] == 0.0 and values["style"] > 0.01
    assert made.pictures.shape == (1, 3, SIZE, SIZE)


@pytest.fixture
def quick(monkeypatch, shown):
    """Photographs and measures that take no time: what is tested is what is made of them."""
    monkeypatch.setattr(evaluate, "photographed", lambda entry: replace(shown, entry=entry))
    monkeypatch.setattr(evaluate, "compared", lambda shown, made: {"style": 0.5})
    monkeypatch.setattr(evaluate, "SIZE", 16)


def method(calls, name, follows=None):
    def made(shown, _seed):
        calls.append(name)
        return Made(torch.full((1, 3, 16, 16), 0.5), 1.0)

    return Configuration(made, settings=follows)


def test_measuring_goes_on_from_what_is_there(quick, pack, tmp_path):
    entries, calls = pack.reporting[:2], []
    assert len({entry.material for entry in entries}) == 2
    methods = {name: method(calls, name) for name in ("first", "second")}
    evaluate.measured("some", {"first": methods["first"]}, entries, tmp_path)
    rows = evaluate.measured("some", methods, entries, tmp_path)
    assert calls == ["first"] * 2 + ["second"] * 2 and len(rows) == 4
    assert len(list((tmp_path / "some").glob("*.png"))) == 4
    other = {"first": method(calls, "first", "another prior")}
    evaluate.measured("some", other, entries[:1], tmp_path)
    assert calls[4:] == ["first"]


def test_an_evaluation_writes_its_page_and_a_picture_without_the_photographs(
    quick, prior, pack, tmp_path, monkeypatch
):
    names = ("prior, not tuned", evaluate.ALBEDO)
    monkeypatch.setattr(
        evaluate, "methods_of", lambda prior, settings: {name: method([], name) for name in names}
    )
    settings = evaluate.EvaluateSettings(materials=1)
    page = evaluate.run_evaluation(prior, pack, settings, tmp_path, "matcap ...")
    assert (tmp_path / "prior-evaluation.md").read_text() == page
    assert (tmp_path / "prior-evaluation.jpg").is_file()
    assert "`matcap ...`" in page and "| photograph as albedo | " in page
    assert page.count(" | 0.500 |") == 2
    assert "Rows: prior, not tuned.]" in page


def test_only_what_starts_from_the_prior_depends_on_it(prior):
    settings = evaluate.EvaluateSettings()

    def result():
        methods = evaluate.methods_of(prior, settings)
        return {name: method.settings for name, method in methods.items()}

    before = result()
    with torch.no_grad():
        prior.decoder.head.convolution.weight.mul_(1.1)
    changed = {name for name, follows in result().items() if follows != before[name]}
    assert changed == {"prior, not tuned", "prior, 100 steps"}


def test_a_capture_is_measured_from_start_to_realisations(prior, shown, monkeypatch):
    monkeypatch.setattr(evaluate, "REALISATIONS", 2)
    one = capture(shown, evaluate.from_nothing, 0)
    assert one.pictures.shape == (2, 3, SIZE, SIZE)
    values = compared(shown, one)
    assert math.isfinite(values["style"]) and values["diversity"] > 0.1


def test_an_interrupted_capture_is_no_result(shown, monkeypatch):
    def interrupted(decoder, *_):
        return Tuned(decoder, (), (), True)

    monkeypatch.setattr(evaluate, "finetune", interrupted)
    with pytest.raises(KeyboardInterrupt):
        capture(shown, evaluate.from_nothing, 3)
