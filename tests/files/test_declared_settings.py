"""Settings, names, tensors and interrupts."""

import math
import os
import random
import signal
import stat
import subprocess
import sys
from dataclasses import fields
from unittest.mock import ANY

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import save_file

from matcap.batch.samples import BatchSettings
from matcap.capture.settings import CaptureSettings, InspectSettings, OutputSettings
from matcap.cli.main import main
from matcap.cli.relight import RelightOptions, ViewOptions
from matcap.errors import MatcapError, UsageError
from matcap.export.options import ExportArea, ExportOptions
from matcap.field.options import BlendOptions, DrawOptions, ReadOptions, SampleOptions
from matcap.files.names import (
    StagedFolder,
    digest_matches,
    name_fault,
    plain_name,
    sanitised_name,
    usable_name,
)
from matcap.files.output import Output
from matcap.files.process import postponed, starting_children
from matcap.files.settings import (
    Rectangle,
    Size,
    duration,
    field_docs,
    nearest,
    region,
    settings_in,
    size,
)
from matcap.files.tensors import write_tensors
from matcap.synth.request import SynthArea, SynthRequest, Work

# Settings are told once, and mean the same from Python, from a file and from the command line.

KINDS = (
    CaptureSettings, InspectSettings, OutputSettings, BatchSettings, ReadOptions, ExportOptions,
    ExportArea, SynthRequest, SynthArea, Work, RelightOptions, DrawOptions, SampleOptions,
    BlendOptions, ViewOptions,
)  # fmt: skip
ALL = [one for kind in KINDS for one in settings_in(kind).values()]
BOUNDED = [one for one in ALL if math.isfinite(one.least)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_setting_has_documentation_below_it(kind):
    result = field_docs(kind)
    assert all(result.get(one.name, "").endswith(".") for one in fields(kind) if one.init)


def test_no_two_settings_of_a_command_share_a_name():
    for kinds in ((CaptureSettings, OutputSettings, BatchSettings), (SynthRequest, ReadOptions)):
        names = [one.name for kind in kinds for one in settings_in(kind).values()]
        assert len(names) == len(set(names))


@given(st.data())
def test_a_number_is_taken_within_its_limits_and_nowhere_else(data):
    one = data.draw(st.sampled_from(BOUNDED))
    least, most = one.least, one.most
    numbers = st.integers if one.kind is int else st.floats
    inside = data.draw(numbers(one.kind(least), one.kind(most)))
    assert one.typed(inside, "here") == inside
    beyond = [least - 1, most * 2 + 1] + [math.nan, math.inf] * (one.kind is float)
    outside = one.kind(data.draw(st.sampled_from(beyond)))
    with pytest.raises(UsageError, match="here: "):
        one.typed(outside, "here")


@pytest.mark.parametrize("one", ALL, ids=lambda one: one.name)
def test_a_default_is_a_value_and_another_kind_is_none(one):
    if one.default is not None and not one.several:
        assert one.typed(one.default, "here") == one.default
    with pytest.raises(UsageError, match="here: "):
        one.typed({"a": 1}, "here")


def test_python_and_the_command_line_refuse_alike(capsys):
    for options, code in ((("--detail", "10"), 2), (("--preset", "drafd"), 2)):
        assert main(["capture", "none.jpg", *options]) == code
    with pytest.raises(UsageError, match=r"--detail: 10 is out of range; give between 64 and 8192"):
        CaptureSettings(detail=10)
    with pytest.raises(UsageError, match="--preset: there is no choice 'drafd'; did you mean 'd"):
        CaptureSettings(preset="drafd")
    capsys.readouterr()


def test_the_nearest_word_or_all_there_are():
    assert nearest("prest", ["preset", "steps"]) == "did you mean 'preset'"
    assert nearest("unity", ["raw", "unity-hdrp", "unity-urp"]) == "did you mean 'unity-hdrp'"
    assert nearest("qqqq", ["preset", "steps"]) == "choose from preset, steps"
    assert nearest("nope", ["top", "left"], "or a file") == "choose from top, left or a file"


# Sizes, rectangles, times and names as typed or found in files.

NASTY = (
    "", " ", ".", "..", ".hidden", "../keep", "../../victim/keep", "/etc/passwd", "a/b", "a\\b",
    "a\0b", "a\nb", "a\x1b[2Jb", "a\u202eb", "\ud800", "x" * 201, "é" * 150,
)  # fmt: skip
FINE = ("leather", "Leather (2), brown", "dose & co", "Holz'stück", "木目", "a.b", "x" * 200)


@pytest.mark.parametrize("name", NASTY)
def test_a_dangerous_name_is_refused_and_sanitised(name):
    with pytest.raises(UsageError, match="is not a plain file name: it") as caught:
        plain_name(name)
    assert caught.value.sentence().isprintable()
    assert name_fault(sanitised_name(name)) == name_fault(usable_name(name)) == ""


@pytest.mark.parametrize("name", FINE)
def test_ordinary_names_are_kept(name):
    assert plain_name(name) == usable_name(name) == name


@pytest.mark.parametrize("name", [3, None, ["a"], b"a"])
def test_names_that_are_no_text_are_refused(name):
    assert name_fault(name) == "is no text"


@pytest.mark.parametrize("name", ["../keep", "..", "/etc/passwd", "a/../../b", "", "."])
def test_nothing_is_staged_outside_its_folder(tmp_path, name):
    (tmp_path / "keep").write_text("mine")
    with (
        pytest.raises(MatcapError, match="leads out of the folder"),
        Output(tmp_path / "out").stage() as stage,
    ):
        (stage / name).write_text("theirs")
    assert [file.name for file in tmp_path.iterdir()] == ["keep"]
    assert (tmp_path / "keep").read_text() == "mine"


def test_ten_thousand_names_are_plain_once_made_so(tmp_path):
    chance = random.Random(1)
    alphabet = "ab/\\.\0\n\r\t\x1b\u202e\u2028 é木-_:*?\"<>|~$'`{}%&#@"
    stage = StagedFolder(tmp_path)
    for _ in range(10_000):
        name = "".join(chance.choice(alphabet) for _ in range(chance.randrange(12)))
        plain = sanitised_name(name)
        assert name_fault(plain) == "" and (stage / plain).parent == tmp_path
        if name_fault(name) == "":
            assert (stage / name).parent == tmp_path


def test_sizes_are_parsed():
    assert size("4096x256") == Size(4096, 256) and size("512") == Size(512, 512)
    assert size("2K") == Size(2048, 2048) and size("4kx512") == Size(4096, 512)
    assert size(str(Size(3, 4))) == Size(3, 4)


def test_regions_are_parsed():
    assert region("-100,0,512,256") == Rectangle(-100, 0, 512, 256)
    assert region(f"{2**40 - 8},{-(2**40)},8,8") == Rectangle(2**40 - 8, -(2**40), 8, 8)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("20s", 20), ("1.5m", 90), ("2h", 7200), (".5", 0.5)]
)
def test_durations_are_parsed(text, seconds):
    assert duration(text) == seconds


WRONG = {
    size: ("", "x", "4x", "x4", "4x0", "0", "-4x4", "4.5x4", "4x4x4", "1e3"),
    region: ("", "1,2,3", "1,2,3,x", "0,0,0,5", "0,0,5,-5", f"{2**40},0,1,1"),
    duration: ("", "0", "-1", "s", "1d", "nan", "inf", "1e3", "9" * 400),
}


@pytest.mark.parametrize(("read", "text"), [(read, text) for read in WRONG for text in WRONG[read]])
def test_malformed_values_are_named(read, text):
    with pytest.raises(ValueError, match=r"^'.*' "):
        read(text)


# Tensors in a file: whole, and for whoever the folder is for.


def test_tensors_and_metadata_are_read_back(tmp_path):
    path = tmp_path / "new" / "a.safetensors"
    transposed = torch.arange(6.0).reshape(2, 3).T
    write_tensors(path, {"a": transposed, "b": torch.tensor([True])}, {"about": "x"})
    with safe_open(path, framework="pt") as file:
        assert file.metadata() == {"about": "x", "digest": ANY}
        assert torch.equal(file.get_tensor("a"), transposed)
        assert torch.equal(file.get_tensor("b"), torch.tensor([True]))
    assert [f.name for f in path.parent.iterdir()] == ["a.safetensors"]


def test_the_file_has_the_permissions_of_other_files(tmp_path):
    old = os.umask(0o022)
    try:
        write_tensors(tmp_path / "a.safetensors", {"a": torch.zeros(1)}, {})
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.safetensors").stat().st_mode) == 0o644


def test_overflow_of_half_floats_is_reported(tmp_path):
    large = torch.tensor([1.0, 70000.0])
    write_tensors(tmp_path / "whole", {"a": large}, {})
    with pytest.raises(MatcapError, match="b has values too large for half float"):
        write_tensors(tmp_path / "half", {"a": large, "b": large.half()}, {})
    assert [file.name for file in tmp_path.iterdir()] == ["whole"]


def whole(path):
    with safe_open(path, framework="pt") as file:
        return digest_matches(path, file.metadata())


@pytest.mark.parametrize("place", [-1, -100, -400])
def test_one_flipped_bit_in_a_tensor_is_noticed(tmp_path, place):
    path = tmp_path / "a.safetensors"
    write_tensors(path, {"a": torch.arange(100.0), "b": torch.ones(1)}, {"about": "x"})
    assert whole(path)
    written = bytearray(path.read_bytes())
    written[place] ^= 1
    path.write_bytes(written)
    assert not whole(path)


def test_a_changed_text_is_noticed(tmp_path):
    path = tmp_path / "a.safetensors"
    write_tensors(path, {"a": torch.zeros(3)}, {"about": "size 1"})
    path.write_bytes(path.read_bytes().replace(b"size 1", b"size 7"))
    assert not whole(path)


def test_a_file_without_a_digest_is_refused(tmp_path):
    save_file({"a": torch.zeros(3)}, tmp_path / "old.safetensors", {"about": "x"})
    assert not whole(tmp_path / "old.safetensors")


# Signals: alike, postponed where work must be whole, and no matter to children.

BOTH = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture(autouse=True)
def ctrl_c_is_heard():
    """What starts the tests may ignore it, as xdist's workers do."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", BOTH)
def test_a_postponed_signal_is_delivered_and_handlers_are_restored(number):
    before = [signal.getsignal(which) for which in BOTH]
    with postponed() as came:
        assert not came()
        os.kill(os.getpid(), number)
        assert came()
    assert came() and [signal.getsignal(which) for which in BOTH] == before


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_while_children_start_is_postponed(number):
    reached = []
    with pytest.raises(KeyboardInterrupt), starting_children():
        os.kill(os.getpid(), number)
        reached.append(True)
    assert reached and signal.pthread_sigmask(signal.SIG_BLOCK, []) == set()


@pytest.mark.parametrize("number", BOTH)
def test_both_signals_raise_keyboard_interrupt(number):
    program = (
        "import os, sys; from matcap.files.process import raise_on_signals\n"
        "came = raise_on_signals()\n"
        f"try: os.kill(os.getpid(), {int(number)}); input()\n"
        "except KeyboardInterrupt: sys.exit(7 if came() else 8)\n"
    )

    def heed():
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    run = subprocess.run([sys.executable, "-c", program], preexec_fn=heed, check=False)
    assert run.returncode == 7


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_waits_until_torch_is_imported(tmp_path, number):
    """Its C++ aborts at an exception in what it imports."""
    (tmp_path / "torch.py").write_text(
        f"import os, time; os.kill(os.getpid(), {int(number)}); time.sleep(0.2); whole = True\n"
    )
    program = (
        "import sys, time; from matcap.files.process import raise_on_signals\n"
        "raise_on_signals()\n"
        "try: import torch; time.sleep(30)\n"
        "except KeyboardInterrupt: sys.exit(7 if hasattr(sys.modules.get('torch'), 'whole') else 8)"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    run = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path}, check=False
    )
    assert run.returncode == 7
