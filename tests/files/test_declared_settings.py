"""Settings are told once, and mean the same from Python, from a file and from the command line."""

import math
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcap.batch.settings import BatchSettings
from matcap.capture.settings import CaptureSettings, InspectSettings, OutputSettings
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.export.options import ExportArea, ExportOptions
from matcap.field.draw_options import BlendOptions, DrawOptions, SampleOptions
from matcap.field.options import ReadOptions
from matcap.files.settings import field_docs, nearest, settings_in
from matcap.relight.options import RelightOptions
from matcap.synth.request import SynthArea, SynthRequest, Work
from matcap.view.options import ViewOptions

KINDS = (
    CaptureSettings, InspectSettings, OutputSettings, BatchSettings, ReadOptions, ExportOptions,
    ExportArea, SynthRequest, SynthArea, Work, RelightOptions, DrawOptions, SampleOptions,
    BlendOptions, ViewOptions,
)  # fmt: skip
ALL = [one for kind in KINDS for one in settings_in(kind).values()]
BOUNDED = [one for one in ALL if math.isfinite(one.rule.least)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_told_of_below_itself(kind):
    result = field_docs(kind)
    assert all(result.get(one.name, "").endswith(".") for one in fields(kind) if one.init)


def test_no_two_settings_of_a_command_share_a_name():
    for kinds in ((CaptureSettings, OutputSettings, BatchSettings), (SynthRequest, ReadOptions)):
        names = [one.name for kind in kinds for one in settings_in(kind).values()]
        assert len(names) == len(set(names))


@given(st.data())
def test_a_number_is_taken_within_its_limits_and_nowhere_else(data):
    one = data.draw(st.sampled_from(BOUNDED))
    least, most = one.rule.least, one.rule.most
    numbers = st.integers if one.kind is int else st.floats
    inside = data.draw(numbers(one.kind(least), one.kind(most)))
    assert one.typed(inside, "here") == inside
    beyond = [least - 1, most * 2 + 1] + [math.nan, math.inf] * (one.kind is float)
    outside = one.kind(data.draw(st.sampled_from(beyond)))
    with pytest.raises(UsageError, match="here: "):
        one.typed(outside, "here")


@pytest.mark.parametrize("one", ALL, ids=lambda one: one.name)
def test_a_default_is_a_value_and_another_kind_is_none(one):
    if one.default is not None and not one.rule.several:
        assert one.typed(one.default, "here") == one.default
    with pytest.raises(UsageError, match="here: "):
        one.typed({"a": 1}, "here")


def test_python_and_the_command_line_refuse_alike(capsys):
    for options, code in ((("--detail", "10"), 2), (("--preset", "drafd"), 2)):
        assert main(["capture", "none.jpg", *options]) == code
    with pytest.raises(UsageError, match=r"--detail: 10 is out of range; give between 64 and 8192"):
        CaptureSettings(detail=10)
    with pytest.raises(UsageError, match="--preset: there is no preset 'drafd'; did you mean 'd"):
        CaptureSettings(preset="drafd")
    capsys.readouterr()


def test_the_nearest_word_or_all_there_are():
    assert nearest("prest", ["preset", "steps"]) == "did you mean 'preset'"
    assert nearest("qqqq", ["preset", "steps"]) == "choose from preset, steps"
