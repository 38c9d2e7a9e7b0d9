"""The change that docs/guide/extend.md walks through, done as the page says."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from matcap.relight.effects.entries import EFFECTS, Effect

ROOT = Path(__file__).parents[2]


@pytest.fixture
def steps() -> list[str]:
    """The page's Python, in order: effect, entry, scenes, share reached, test."""
    text = (ROOT / "docs/guide/extend.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def test_the_effect_works_and_keeps_its_bound(steps, monkeypatch):
    effect, entry, scenes, reached, test = steps
    fuzz = ModuleType("fuzz")
    exec(compile(effect, "fuzz.py", "exec"), vars(fuzz))
    listed = eval(f"{{{entry}}}", {"Effect": Effect, "fuzz": fuzz})
    monkeypatch.setitem(EFFECTS, "fuzz", listed["fuzz"])
    monkeypatch.syspath_prepend(ROOT / "tests/relight")
    samples = import_module("bound_scenes")
    flat = import_module("relight_samples").flat
    names = {
        **vars(samples),
        "white": flat(diffuse=0.9, specular=0.0, roughness=1.0),
        "even": samples.EnvironmentLight(radiance=(1.0, 1.0, 1.0)),
    }
    exec(compile(scenes, "bound_scenes.py", "exec"), names)
    shares = [samples.share("fuzz", one) for one in names["fuzz"]()]
    assert eval(f"{{{reached}}}")["fuzz"] <= max(shares) <= 1.0
    exec(compile(test, "test_fuzz.py", "exec"), names)
    names["test_fuzz_is_the_formula"]()
