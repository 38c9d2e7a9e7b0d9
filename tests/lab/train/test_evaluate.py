"""Evaluation and ablation: measured once, written as a page and a picture."""

import math
from dataclasses import replace

import pytest
import torch

from matcap.lab.train import ablate, evaluate, measure
from matcap.lab.train.decoder_only import DecoderOnly
from matcap.lab.train.measure import SIZE, Made, Result, capture, judge, photographed
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, Tuned


@pytest.fixture(scope="module")
def shown(pack):
    return photographed(pack.reporting[0])


def test_the_photograph_itself_is_without_error(shown):
    result = judge("itself", Made(shown.truth[None], 0.0), shown)
    assert (result.style, result.xyz, result.diversity) == (0.0, 0.0, 0.0)
    assert result.material == shown.entry.material


def test_the_photograph_as_albedo_is_one_picture_lit_twice(shown):
    result = judge("albedo", evaluate.albedo(shown), shown)
    assert result.diversity == 0.0
    assert result.style > 0.01
    assert result.picture.shape == (3, SIZE, SIZE)


@pytest.fixture
def quick(monkeypatch, shown):
    """Photographs and judgements that take no time: what is tested is what is made of them."""
    monkeypatch.setattr(evaluate, "photographed", lambda entry: replace(shown, entry=entry))

    def judged(method, made, shown):
        numbers = (0.1 * len(method), 0.2, 0.3, made.seconds)
        return Result(shown.entry.material, method, *numbers, made.pictures[0])

    monkeypatch.setattr(evaluate, "judge", judged)


def made(calls, name):
    def run(photographed):
        calls.append(name)
        return Made(torch.full((1, 3, 16, 16), 0.5), 1.0)

    return run


def test_measuring_goes_on_from_what_is_there(quick, pack, tmp_path):
    entries, calls = pack.reporting[:2], []
    first = evaluate.EvaluatedMethod("first", made(calls, "first"))
    second = evaluate.EvaluatedMethod("second", made(calls, "second"))
    before = evaluate.measure_all([first], entries, tmp_path)
    after = evaluate.measure_all([first, second], entries, tmp_path)
    assert calls == ["first"] * 2 + ["second"] * 2
    assert [r.style for r in after if r.method == "first"] == [r.style for r in before]
    evaluate.measure_all(
        [evaluate.EvaluatedMethod("first", first.run, ("another prior",))], entries[:1], tmp_path
    )
    assert calls[4:] == ["first"]


def test_an_evaluation_writes_its_page_and_a_picture_without_the_photographs(
    quick, prior, pack, tmp_path, monkeypatch
):
    calls = []
    monkeypatch.setattr(
        evaluate,
        "ways_of",
        lambda prior, settings: [
            evaluate.EvaluatedMethod(name, made(calls, name))
            for name in ("prior, not tuned", evaluate.ALBEDO)
        ],
    )
    shown = []
    write = evaluate.write_sheet
    monkeypatch.setattr(
        evaluate,
        "write_sheet",
        lambda results, path: (shown.extend(results), write(results, path)),
    )
    settings = evaluate.EvaluateSettings(materials=1, tilted=1)
    page = evaluate.run_evaluation(prior, pack, settings, tmp_path, "matcap ...")
    assert (tmp_path / "prior-evaluation.md").read_text() == page
    assert (tmp_path / "prior-evaluation.jpg").is_file()
    assert "`matcap ...`" in page
    assert "| photograph as albedo |" in page
    assert "matcap bench quality" in page
    assert [result.method for result in shown] == ["prior, not tuned"]


def test_only_what_starts_from_the_prior_depends_on_it(prior):
    settings = evaluate.EvaluateSettings()
    before = {way.name: way.follows for way in evaluate.ways_of(prior, settings)}
    ablated = {way.name: way.follows for way in ablate.variants(prior, 2)}
    with torch.no_grad():
        prior.decoder.head.convolution.weight.mul_(1.1)
    changed = {w.name for w in evaluate.ways_of(prior, settings) if w.follows != before[w.name]}
    assert changed == {"prior, not tuned", "prior, 100 steps"}
    changed = {way.name for way in ablate.variants(prior, 2) if way.follows != ablated[way.name]}
    assert changed == {"FULL", "NONTUNED", "FOURIER", "LIGHT"}


def test_an_ablation_holds_every_variant_against_full(
    quick, prior, pack, shown, tmp_path, monkeypatch
):
    begun, rates = [], []

    def captured(tuned, begin, steps, realisations, rate):
        rates.append(rate)
        begun.append((type(begin()[0]), steps, tuned))
        return made([], "")(tuned)

    def straightened(entry):
        scene = replace(shown.scene, setup=entry.coarse.setup)
        return replace(shown, entry=entry, scene=scene)

    monkeypatch.setattr(ablate, "capture", captured)
    monkeypatch.setattr(ablate, "photographed", straightened)
    page = ablate.run_ablation(prior, pack, 7, 1, tmp_path, "matcap ...")
    kinds, steps, views = zip(*begun, strict=True)
    assert [kind is DecoderOnly for kind in kinds] == [False, False, False, True, False, False]
    assert steps == (7, 7, 0, 7, 7, 7)
    # A capture from the prior learns more slowly than one from nothing.
    from_nothing = [rate == RATE_FROM_NOTHING for rate in rates]
    assert from_nothing == [False, True, False, True, False, False]
    assert views[4].scene.weights.spectrum == 0.0
    assert views[5].scene.setup.tilt == (0.0, 0.0) != views[0].scene.setup.tilt
    assert "| FULL |" in page
    assert "| 100 % |" in page
    assert "with SINGLE: it has 183 % of its style error" in page
    assert (tmp_path / "prior-ablation.md").read_text() == page
    assert (tmp_path / "prior-ablation.jpg").is_file()


def test_a_capture_is_measured_from_start_to_realisations(prior, shown):
    one = capture(shown, lambda: evaluate.from_nothing(shown, DecoderOnly), 0, 2)
    assert one.pictures.shape == (2, 3, SIZE, SIZE)
    result = judge("DECODERONLY", one, shown)
    assert math.isfinite(result.style)
    assert result.diversity > 0.1


def test_an_interrupted_capture_is_no_result(shown, monkeypatch):
    def interrupted(decoder, *_):
        return Tuned(decoder, (), (), True)

    monkeypatch.setattr(measure, "finetune", interrupted)
    with pytest.raises(KeyboardInterrupt):
        capture(shown, lambda: evaluate.from_nothing(shown), 3, 1)
