"""Feeds command lines to matcap: an answer in a sentence or a good result, and nothing else.

    python tests/cli/fuzz/lines.py --count 20000

All options are drawn by their kinds, half of the values out of range; names of files and map sets
too. A line fails at exit 1, at a traceback, when it takes over LONGEST seconds or LARGEST bytes, or
when any file outside the folder it runs in appears or changes. test_lines.py runs a shorter form.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "docs" / "tools"))

import cv2
import numpy as np
import torch
from fuzz import most_held, outcome
from inputs import random_maps, write_example, write_material
from reference.commands import parameters

from matcap.batch.worker_pool import Processes
from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.cli.main import app
from matcap.cli.main import main as matcap
from matcap.files.progress import OnProgress

LONGEST, LARGEST = 30.0, 3 << 30  # seconds, bytes
_NUMBERS = (
    "0", "1", "-1", "0.5", "nan", "inf", "-inf", "1e300", "-1e-300", "9" * 23, "x", "", "1e400",
    "0x10", "٣", "1_000", " 7 ", "2",
)  # fmt: skip
_SIZES = (
    "16", "32x16", "17x5", "0", "-1", "1x", "9" * 17, "9999999x9999", "nan", "1K", "1x2x3", "16X16",
)  # fmt: skip
_NAMES = (
    "out", "a/b", "../out", "..", ".", "/dev/null", "/proc/x", "x" * 300, "a\nb", "\x1b[2J",
    "é木", "small.matcap", "set", "set/set.json", "notes.txt", "-o",
)  # fmt: skip
_OUTPUTS = ("new.png", "new.exr", "new.gif", "new.html", "notes.txt", "photo.png", *_NAMES)
_INPUTS = ("small.matcap", "example.matcap", "set", "set/set.json", "photo.png", *_NAMES)
_TARGETS = ("usd", "gltf", "raw", "unreal", "mitsuba", "godot", "bogus", "", "gltf-textures")
_PATTERNS = (
    "{map}", "{stem}_{map}", "{map:>999999999}", "{map!r}", "{map.x}", "{x}", "{", "../{map}",
    "{map}\n", "a@{map}", "{0}", "{map}{map}",
)  # fmt: skip
_ADJUST = ("relief=1.3", "relief=nan", "tint=#fff", "roughness=1e300", "x=1", "relief=", "a.json")
_LIGHTS = ("top", "left", "flash", "1e300,0,1", "0,0,1", "0,0,-1", "nan,0,1", "x", "0,0,1,1e9", "")
_EFFECTS = ("auto", "all", "none", "+x", "none,+diffuse", "", ",")
_SHARES = ("0.5", "0:1:3", "0:1:99999999", "nan", "1:0:2", f"0:1:{'9' * 30}", "-1")
_REGIONS = ("0,0,16,16", "1,1,0,0", "9e9,0,1,1", f"{2**40},0,16,16")
# Values by what help calls them.
_VALUES = {
    "WxH": _SIZES, "CxR": ("1x1", "11x1", "0x0", "nan", "2x1"), "x,y,w,h": _REGIONS,
    "NAME=VALUE,...": _ADJUST, "TARGET": _TARGETS, "PATTERN": _PATTERNS, "A,B": ("diffuse", "x,y"),
    "T|FROM:TO:COUNT": _SHARES, "NAME|x,y,z[,intensity]": _LIGHTS, "FILE|NAME": _NAMES,
    "auto|all|none|+x,-y": _EFFECTS, "tcp://HOST:PORT": ("x", "", "nonsense"),
}  # fmt: skip
_WRITTEN = ("--html", "--explain-map")
# What is not drawn: what takes long, or says less.
_LONG = ("--frames", "--animate", "--sheet", "--like", "--workers", "--resume", "--quiet")
# How many files each command reads.
_READS = {
    "relight": 1, "export": 1, "synth": 1, "blend": 2, "view": 1, "inspect": 1,
}  # fmt: skip


@cache
def options_of(command: str) -> dict[str, tuple[str, ...]]:
    """Every option of a command, with values to draw from; none of a switch."""
    (function,) = (one.callback for one in app.registered_commands if one.name == command)
    found = {}
    for one in parameters(function):
        flags = re.findall(r"`(-[^`]+)`", one.shown)
        if not flags or flags[0] in _LONG:
            continue
        kind, value = one.kind, one.value
        if kind is bool:
            values: tuple[str, ...] = ()
        elif isinstance(kind, type) and issubclass(kind, Enum):
            values = (*(str(word.value) for word in kind), "zz", "")
        elif flags[0] == "--out":
            values = _OUTPUTS if command == "relight" else _NAMES
        elif value == "PATH" or kind is Path:
            values = _OUTPUTS if flags[0] in _WRITTEN else _INPUTS
        else:
            values = _VALUES.get(value, _NUMBERS)
        found[flags[0]] = values
    return found


@dataclass(frozen=True)
class Line:
    """A command line and the folder it runs in."""

    words: tuple[str, ...]
    place: Path


def drawn(chance: random.Random) -> tuple[str, ...]:
    """A command line."""
    command = chance.choice(list(_READS))
    inputs, options = _READS[command], options_of(command)
    words = [command, *(chance.choice(_INPUTS[: 3 if chance.random() < 0.7 else None])
                        for _ in range(inputs))]  # fmt: skip
    chosen = chance.sample(sorted(options), chance.randrange(min(6, len(options)) + 1))
    if command == "view":
        chosen = [*dict.fromkeys(["--html", *chosen])]  # else it serves until Ctrl-C
    for option in chosen:
        words += [option, *([chance.choice(options[option])] if options[option] else [])]
    if "--size" not in chosen and "--size" in options:
        words += ["--size", "16"]  # soon done
    return (*words, "-j", "1") if command == "synth" else tuple(words)


def answer(line: Line, tell: OnProgress) -> tuple[str, str]:
    """Run a line, in a worker: ("good", "refused" or "fault", what was said)."""
    os.chdir(line.place / "work")
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        code = matcap(list(line.words))
    text = said.getvalue()
    if code not in (0, 2, 3, 4) or "Traceback" in text or "internal error" in text:
        return "fault", f"exit {code}: {text[-600:]}"
    if most_held() > LARGEST:
        return "fault", f"{most_held() / 1e9:.1f} GB of memory"
    return ("refused" if code else "good"), text


def prepare() -> None:
    """Once a worker."""
    torch.set_num_threads(1)


def write_place(place: Path) -> None:
    """A folder `work` with things to read, and beside it what must stay as it is."""
    work = place / "work"
    work.mkdir(parents=True)
    write_material(work / "small.matcap")
    write_example(work / "example.matcap")
    write_mapset(random_maps(16, 16, low=0.1, high=0.6), work / "set", MapSetInfo("set"))
    (work / "notes.txt").write_text("mine")
    cv2.imwrite(str(work / "photo.png"), np.full((96, 128, 3), 128, np.uint8))
    (place / "victim").write_text("mine")


def run(
    place: Path, count: int, seed: int, *, first: int = 0, longest: float = LONGEST
) -> tuple[Counter[str], list[str]]:
    """Tally of the lines from `first` to `count`, and what failed."""
    good = place / "good"
    write_place(good)
    tally: Counter[str] = Counter()
    faults: list[str] = []
    workers = Processes(1, answer, prepare)
    try:
        for number in range(first, count):
            chance = random.Random(f"{seed} {number}")
            now = place / str(number)
            shutil.copytree(good, now)
            if chance.random() < 0.1:  # a forged name
                document = now / "work" / "set" / "set.json"
                # A shell cannot say a null character, a document can.
                forged = chance.choice((*_NAMES, "a\0b"))
                about = json.loads(document.read_text()) | {"name": forged}
                document.write_text(json.dumps(about))
            words = drawn(chance)
            limit = longest + 50.0 * (number == first)  # the imports, too
            result, said = outcome(workers, Line(words, now), limit)
            here = sorted(file.name for file in now.iterdir())
            inside = (now / "victim").read_text() == "mine"
            # `-o ../out` and `-o ..` are asked for: everything else beside the folder is nobody's.
            asked = ".." in words or set(here) <= {"work", "victim", "out"}
            if result != "fault" and not (inside and asked):
                result, said = "fault", f"beside the folder stands {here}"
            tally[result] += 1
            tally[f"{words[0]} {result}"] += 1
            if result == "fault":
                faults.append(f"{number}: matcap {' '.join(map(repr, words))}\n{said}")
                print(faults[-1], file=sys.stderr, flush=True)  # one who waits no longer knows it
            shutil.rmtree(now)
    finally:
        workers.close()
    return tally, faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="go on from this line of the seed's")
    parser.add_argument(
        "--longest", type=float, default=LONGEST, help="seconds, more where other work runs"
    )
    options = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="matcap-lines-") as place:
        tally, faults = run(
            Path(place), options.count, options.seed,
            first=options.first, longest=options.longest,
        )  # fmt: skip
    for name, number in sorted(tally.items()):
        print(f"{number:8d}  {name}")
    count, took = options.count - options.first, time.monotonic() - began
    print(f"{count} lines in {took:.0f} s, {len(faults)} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
