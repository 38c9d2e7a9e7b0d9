"""What the fronts compare: ways to capture a material, each as a command line has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from matcap.capture.settings import PRESETS, CaptureSettings

PAPER = "paper's form"  # no command line: bench/paper.py
BASE = "1024 texels, 40 steps"  # that others are paired with
_LARGE = 4096  # pixels across: photographs that have the finest detail


@dataclass(frozen=True)
class Way:
    """A way of capturing.

    Attributes:
        group: what it varies.
        options: of `matcap capture`.
        photographs: of one piece.
        pixels: across of the photographs, or None for the bench's usual.
    """

    group: str
    options: tuple[str, ...] = ()
    photographs: int = 1
    pixels: int | None = None


def _ways() -> dict[str, Way]:
    ways: dict[str, Way] = {}
    options: tuple[str, ...]
    for detail in (512, 1024):
        for steps in (0, 16, 40, 120, 320):
            options = ("--detail", f"{detail}", "--steps", f"{steps}")
            ways[f"{detail} texels, {steps} steps"] = Way("one photograph", options)
    for detail in (512, 1024):
        for count in (2, 3, 5, 9):
            options = ("--detail", f"{detail}", "--together")
            ways[f"{detail} texels, {count} photographs"] = Way("several", options, count)
    for seconds in (10, 20, 40, 60):
        ways[f"--time {seconds}s"] = Way("time", ("--time", f"{seconds}s"))
    for steps in (0, 32, 160, 320, 800):
        options = ("--generator", "decoder", "--preset", "reference", "--steps", f"{steps}")
        ways[f"decoder, {steps} steps"] = Way("decoder", options)
    for detail in (512, 1024, 2048, 4096):
        options = ("--detail", f"{detail}", "--steps", "40")
        ways[f"12 megapixels, {detail} texels"] = Way("detail", options, pixels=_LARGE)
    ways[PAPER] = Way("paper")
    return ways


WAYS: Mapping[str, Way] = MappingProxyType(_ways())
# Without a choice all are measured but the paper's form, which takes an hour a subject, and what
# needs large photographs.
USUAL = tuple(name for name, way in WAYS.items() if way.group not in ("paper", "detail"))


def preset_points(pixels: int = 1200) -> Mapping[str, str]:
    """Points to the presets that they are, of photographs of so many pixels across."""
    named: dict[str, str] = {}
    for name, effort in PRESETS.items():
        detail = CaptureSettings(preset=name).detail_of(pixels)
        point = f"{detail} texels, {effort.adapted} steps"
        named[point] = f"{named[point]}, {name}" if point in named else name
    return named
