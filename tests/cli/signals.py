"""Signals at random moments.

Commands run as processes of their own, in a folder that begins empty. Whatever the moment: no
traceback, nothing leaked, no torn file; what is there is whole.
"""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import MapSet
from matcap.field.material import Material

MATCAP = (sys.executable, "-m", "matcap.cli.start")
COMMANDS = {
    "capture": ("capture", "photo.jpg", "--preset", "draft", "--detail", "256", "--size", "256"),
    "synth": ("synth", "--size", "1024", "-j", "2", "-o", "more", "--generator", "decoder"),
    "batch": (
        "batch", "shoot", "-j", "2", "--detail", "256", "--size", "256",
    ),
    "relight": ("relight", "set", "--size", "1500", "--effects", "all", "-o", "relit/a.png"),
    "export": ("export", "set", "--to", "polyhaven", "-o", "exported"),
    "view": ("view", "set", "--html", "page/a.html"),
}  # fmt: skip
BEST_SO_FAR = "the best so far"  # as capture says it
_NEVER = ("Traceback", "Error:", "leaked", "resource_tracker", "internal error")
_KILLED = {-signal.SIGTERM, -signal.SIGINT}  # before the command line was there


@dataclass(frozen=True)
class Struck:
    """What became of a command."""

    code: int
    said: str


def prepare(folder: Path) -> None:
    """Photographs to be captured, and a map set."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[-0.75:0.75:192j, -1.0:1.0:256j]
    grain = cv2.GaussianBlur(rng.normal(0.0, 1.0, (192, 256, 3)), (0, 0), 1.5)
    linear = (0.4 / (1.0 + x**2 + y**2))[..., None] * np.exp(grain)
    picture = (255.0 * linear.clip(0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    (folder / "shoot").mkdir()
    for name in ("photo.jpg", "shoot/a.jpg", "shoot/b.jpg"):
        cv2.imwrite(str(folder / name), picture)
    stack = 0.2 + 0.5 * torch.rand(6, 256, 256, generator=torch.Generator().manual_seed(1))
    stack[5] *= 0.01
    write_mapset(MapSet.from_stacked(stack, 2.0 / 256), folder / "set", MapSetInfo("moss"))


def strike(command: str, folder: Path, number: int, after: float) -> Struck:
    """Run a command and send it a signal after so many seconds, unless it has ended.

    Args:
        command: its name.
        folder: in which it runs.
        number: of the signal.
        after: seconds.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    run = subprocess.Popen(
        [*MATCAP, *COMMANDS[command]], cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        run.wait(after)
    except subprocess.TimeoutExpired:
        run.send_signal(number)
    said = run.communicate(timeout=600)[1].decode()
    return Struck(run.returncode, said)


def faults(command: str, folder: Path, struck: Struck) -> list[str]:
    """What must not be."""
    found = [word for word in _NEVER if word in struck.said]
    if struck.code not in (0, 130, *_KILLED):
        found.append(f"exit code {struck.code}")
    if struck.code == 130 and "interrupted" not in struck.said:
        found.append("nothing was said")
    if command == "synth":
        return [*found, *_synthesised(folder / "more", struck)]
    needed = struck.code == 0 or (command == "capture" and BEST_SO_FAR in struck.said)
    for name, whole in _WHOLE[command].items():
        found += _all_or_none(folder / name, whole, needed=needed)
    return found


def _captured(folder: Path) -> bool:
    json.loads((folder / "report.json").read_text())
    read_mapset(folder / f"{folder.name}.json")
    Material.load(folder / f"{folder.name}.matcap")
    return True


def _exported(folder: Path) -> bool:
    about = json.loads((folder / "moss_polyhaven.json").read_text())
    return all((folder / file).stat().st_size for file in about["files"])


# By command the folders that it makes, and whether one is whole.
_WHOLE: dict[str, dict[str, Callable[[Path], bool]]] = {
    "capture": {"out/photo": _captured},
    "batch": {"materials/a": _captured, "materials/b": _captured},
    "relight": {"relit": lambda place: cv2.imread(str(place / "a.png")).shape[1] == 1500},
    "export": {"exported": _exported},
    "view": {"page": lambda place: (place / "a.html").read_text().rstrip().endswith("</html>")},
}


def _synthesised(more: Path, struck: Struck) -> list[str]:
    if struck.code == 0:
        read_mapset(more)
        return []
    shown = [file.name for file in more.glob("[!.]*")]
    return [f"half a map set: {shown}"] if shown else []


def _all_or_none(folder: Path, whole: Callable[[Path], bool], *, needed: bool) -> list[str]:
    """A folder that a command made is whole, or is not there."""
    if not folder.exists():
        return ["nothing was written"] if needed else []
    hidden = [file.name for file in folder.glob(".*")]
    return hidden + ([] if whole(folder) else ["half of it stands there"])
