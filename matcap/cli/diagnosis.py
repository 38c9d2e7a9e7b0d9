"""Versions, devices and a self-test of this installation, for bug reports."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from time import perf_counter
from typing import Any

from matcap.errors import MatcapError
from matcap.example import library as example_loops
from matcap.files.maker import MAKER_VERSION
from matcap.relight.loops import library as relighting_loops

_PLACE = Path(__file__).parents[1]  # the installed package
_COMPILED = "compiled loops"
_MISSING = "not built, it cannot run; install matcap again where there is a C compiler"
_SIDE = 256  # texels of the self-test's maps


@dataclass(frozen=True)
class Package:
    """A package that matcap needs or can use."""

    name: str
    """Name on PyPI."""
    version: str | None
    """Installed version, or None."""


@dataclass(frozen=True)
class Extra:
    """An optional part of matcap."""

    name: str
    """Name in brackets after `matcap`."""
    packages: tuple[Package, ...]
    """Packages that it installs."""

    @property
    def installed(self) -> bool:
        """Whether all its packages are installed."""
        return all(package.version for package in self.packages)

    @property
    def command(self) -> str:
        """Command that installs it."""
        return f'pip install "matcap[{self.name}]"'


@dataclass(frozen=True)
class Check:
    """One step of the self-test."""

    name: str
    """What it tests."""
    seconds: float
    """Duration, seconds."""
    fault: str | None
    """Error message, or None."""


@dataclass(frozen=True)
class Diagnosis:
    """Packages, extras, devices and checks of the installation."""

    matcap: str
    """Version of matcap."""
    python: str
    """Version of Python."""
    system: str
    """Operating system and processor."""
    place: str
    """Folder of the installed package."""
    cores: int
    """Number of cores that this process may use."""
    devices: tuple[str, ...]
    """Devices of torch."""
    compiled: bool
    """Whether the compiled loops of the field by example exist; it cannot run without."""
    compiled_relighting: bool
    """Whether the compiled loops of relighting exist; it cannot run without."""
    prior: int | None
    """Bytes of the shipped prior, or None if it is missing."""
    packages: tuple[Package, ...]
    """Required packages."""
    extras: tuple[Extra, ...]
    """Optional packages."""
    checks: tuple[Check, ...]
    """Steps of the self-test, in order, up to the first fault."""

    @property
    def healthy(self) -> bool:
        """Whether all required packages are installed and all checks passed."""
        whole = self.prior is not None and all(one.version for one in self.packages)
        return whole and all(check.fault is None for check in self.checks)

    def as_json(self) -> dict[str, Any]:
        """The diagnosis as JSON values."""
        report = asdict(self)
        for extra, entry in zip(self.extras, report["extras"], strict=True):
            entry |= {"installed": extra.installed, "command": extra.command}
        return report | {"healthy": self.healthy}

    def text(self) -> str:
        """The diagnosis as text."""
        lines = [
            f"matcap {self.matcap} in {self.place}",
            f"Python {self.python}, {self.system}",
            f"{self.cores} cores; devices: {', '.join(self.devices) or 'unknown'}",
            "field by example: " + (_COMPILED if self.compiled else _MISSING),
            "relighting: " + (_COMPILED if self.compiled_relighting else _MISSING),
            "prior " + ("MISSING" if self.prior is None else f"{self.prior / 1e6:.1f} MB"),
            "",
            "Needed",
            *(f"  {one.name:<32} {one.version or 'MISSING'}" for one in self.packages),
            "",
            "Extras",
        ]
        for extra in self.extras:
            parts = ", ".join(f"{one.name} {one.version or '-'}" for one in extra.packages)
            lines.append(f"  {extra.name:<10} {parts}")
            if not extra.installed:
                lines.append(f"  {'':<10} not installed: {extra.command}")
        lines += ["", "Self-test"] if self.checks else []
        for check in self.checks:
            lines.append(f"  {check.name:<32} {check.fault or 'ok'}, {check.seconds:.1f} s")
        lines += ["", "All is well." if self.healthy else "Something is wrong; see above."]
        return "\n".join(lines)


def diagnose(*, self_test: bool = True) -> Diagnosis:
    """Diagnose the installation, without raising.

    Args:
        self_test: also run a small material from the prior to a picture, which takes seconds.
    """
    packages, extras = _requirements()
    missing = [package.name for package in packages if package.version is None]
    return Diagnosis(
        matcap=MAKER_VERSION,
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        place=str(_PLACE),
        cores=_cores(),
        devices=_devices(),
        compiled=example_loops.built() is not None,
        compiled_relighting=relighting_loops.built() is not None,
        prior=_prior(),
        packages=packages,
        extras=extras,
        checks=_self_test() if self_test and not missing else (),
    )


def _requirements() -> tuple[tuple[Package, ...], tuple[Extra, ...]]:
    """Packages needed, and extras, as the installed metadata state them."""
    needed: list[Package] = []
    extras: dict[str, list[Package]] = {}
    try:
        stated = requires("matcap") or []
    except PackageNotFoundError:
        stated = []
    for requirement in stated:
        named = re.match(r"[A-Za-z0-9._-]+", requirement)
        belongs = re.search(r"extra\s*==\s*['\"]([^'\"]+)", requirement)
        if named is None:
            continue
        package = Package(named[0], _version(named[0]))
        if belongs is None:
            needed.append(package)
        elif belongs[1] != "dev":
            extras.setdefault(belongs[1], []).append(package)
    return tuple(needed), tuple(Extra(name, tuple(parts)) for name, parts in extras.items())


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _devices() -> tuple[str, ...]:
    """Devices that torch can use; empty where torch cannot be loaded."""
    try:
        import torch
    except (ImportError, OSError):
        return ()
    graphics = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    return ("cpu", *graphics)


def _prior() -> int | None:
    file = _PLACE / "space" / "prior" / "weights" / "prior.safetensors"
    return file.stat().st_size if file.is_file() else None


def _self_test() -> tuple[Check, ...]:
    """Run each step on a small material: packaged prior, synthesis, picture, files."""
    from matcap.brdf.folder import read_mapset
    from matcap.export.targets import export_mapset
    from matcap.field.plane import Rectangle
    from matcap.relight.render import relight
    from matcap.space.prior.store import load_prior
    from matcap.synth.request import SynthRequest
    from matcap.synth.synthesise import synthesise

    results: dict[str, Any] = {}

    def draw() -> None:
        results["material"] = load_prior().draw(0)

    def field() -> None:
        results["maps"] = results["material"].maps(_SIDE, _SIDE, seed=0)

    def light() -> None:
        picture = relight(results["maps"], "top")
        if not 0.0 < float(picture.mean()) < 1e3:
            raise MatcapError("the picture is black or not finite")

    def write(folder: str) -> None:
        area = Rectangle(0, 0, _SIDE, _SIDE)
        synthesise(SynthRequest(results["material"], area, device="cpu"), folder)

    def disk() -> None:
        with tempfile.TemporaryDirectory() as folder:
            write(folder)
            if (read_mapset(Path(folder))[0].height != results["maps"].height).any():
                raise MatcapError("a map set changed when written and read again")

    def export() -> None:
        with tempfile.TemporaryDirectory() as folder:
            write(folder)
            export_mapset(Path(folder), "gltf")

    return _checked(
        {
            "draw a material from the prior": draw,
            f"read {_SIDE} x {_SIDE} texels of it": field,
            "light them": light,
            "write them and read them back": disk,
            "export them as glTF": export,
        }
    )


def _checked(steps: Mapping[str, Callable[[], None]]) -> tuple[Check, ...]:
    """Run steps in order, up to the first failure."""
    checks: list[Check] = []
    for name, step in steps.items():
        start = perf_counter()
        try:
            step()
            fault = None
        except Exception as error:  # any failure is a finding
            fault = f"{type(error).__name__}: {error}"
        checks.append(Check(name, perf_counter() - start, fault))
        if fault is not None:
            break
    return tuple(checks)
