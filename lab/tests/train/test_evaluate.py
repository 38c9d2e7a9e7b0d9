"""Evaluation: measured once, written as a page and a picture."""

import math
from dataclasses import replace

import pytest
import torch

from matcap.space.tuning.finetune import Tuned
from matcap_lab.experiment.runner import Configuration
from matcap_lab.train import evaluate
from matcap_lab.train.evaluate import SIZE, Made, capture, compared, photographed


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
