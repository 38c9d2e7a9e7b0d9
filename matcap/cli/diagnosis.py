"""Versions, devices and a self-test of this installation, for bug reports."""

from __future__ import annotations

import platform
import re
import tempfile
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from time import perf_counter
from typing import Any

from matcap.errors import MatcapError
from matcap.example import library as example_loops
from matcap.files.maker import MAKER_VERSION
from matcap.files.memory import cores
from matcap.relight.loops import library as relighting_loops

_PLACE = Path(__file__).parents[1]  # the installed package
_COMPILED = "compiled loops"
_MISSING = "not built, it cannot run; install matcap again where there is a C compiler"
_SIDE = 256  # texels of the self-test's maps


def diagnose(*, self_test: bool = True) -> dict[str, Any]:
    """Versions, devices, packages and checks of the installation for JSON, without raising.

    `compiled` and `compiled_relighting`: whether the loops of the field by example and of
    relighting are built, without which these cannot run. `prior`: bytes of the shipped one, or
    None. `checks`: steps of the self-test, in order, up to the first fault. `healthy`: whether all
    that is needed is installed and all checks passed.

    Args:
        self_test: also run a small material from the prior to a picture, which takes seconds.
    """
    packages, extras = _requirements()
    whole = all(package["version"] for package in packages)
    checks = _self_test() if self_test and whole else []
    prior = _PLACE / "space" / "prior" / "weights" / "prior.safetensors"
    return {
        "matcap": MAKER_VERSION,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "place": str(_PLACE),
        "cores": cores(),
        "devices": _devices(),
        "compiled": example_loops.built() is not None,
        "compiled_relighting": relighting_loops.built() is not None,
        "prior": prior.stat().st_size if prior.is_file() else None,
        "packages": packages,
        "extras": extras,
        "checks": checks,
        "healthy": whole and prior.is_file() and all(one["fault"] is None for one in checks),
    }


def as_text(report: dict[str, Any]) -> str:
    """A diagnosis as text."""
    lines = [
        f"matcap {report['matcap']} in {report['place']}",
        f"Python {report['python']}, {report['system']}",
        f"{report['cores']} cores; devices: {', '.join(report['devices']) or 'unknown'}",
        "field by example: " + (_COMPILED if report["compiled"] else _MISSING),
        "relighting: " + (_COMPILED if report["compiled_relighting"] else _MISSING),
        "prior " + ("MISSING" if report["prior"] is None else f"{report['prior'] / 1e6:.1f} MB"),
        "",
        "Needed",
        *(f"  {one['name']:<32} {one['version'] or 'MISSING'}" for one in report["packages"]),
        "",
        "Extras",
    ]
    for extra in report["extras"]:
        parts = ", ".join(f"{one['name']} {one['version'] or '-'}" for one in extra["packages"])
        lines.append(f"  {extra['name']:<10} {parts}")
        if not extra["installed"]:
            lines.append(f"  {'':<10} not installed: {extra['command']}")
    lines += ["", "Self-test"] if report["checks"] else []
    for check in report["checks"]:
        lines.append(f"  {check['name']:<32} {check['fault'] or 'ok'}, {check['seconds']:.1f} s")
    lines += ["", "All is well." if report["healthy"] else "Something is wrong; see above."]
    return "\n".join(lines)


def _requirements() -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Packages needed, and extras, as the installed metadata state them."""
    needed: list[dict[str, Any]] = []
    extras: dict[str, list[dict[str, Any]]] = {}
    try:
        stated = requires("matcap") or []
    except PackageNotFoundError:
        stated = []
    for requirement in stated:
        named = re.match(r"[A-Za-z0-9._-]+", requirement)
        belongs = re.search(r"extra\s*==\s*['\"]([^'\"]+)", requirement)
        if named is None:
            continue
        package = {"name": named[0], "version": _version(named[0])}
        if belongs is None:
            needed.append(package)
        elif belongs[1] != "dev":
            extras.setdefault(belongs[1], []).append(package)
    return needed, [
        {
            "name": name,
            "packages": parts,
            "installed": all(one["version"] for one in parts),
            "command": f'pip install "matcap[{name}]"',
        }
        for name, parts in extras.items()
    ]


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _devices() -> list[str]:
    """Devices that torch can use; empty where torch cannot be loaded."""
    try:
        import torch
    except (ImportError, OSError):
        return []
    return ["cpu", *(torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count()))]


def _self_test() -> list[dict[str, Any]]:
    """Run each step on a small material, in order, up to the first failure."""
    from matcap.export.targets import export_mapset
    from matcap.field.opened import open_tile
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
            if (open_tile(Path(folder)).maps.height != results["maps"].height).any():
                raise MatcapError("a map set changed when written and read again")

    def export() -> None:
        with tempfile.TemporaryDirectory() as folder:
            write(folder)
            export_mapset(Path(folder), "gltf")

    steps = {
        "draw a material from the prior": draw,
        f"read {_SIDE} x {_SIDE} texels of it": field,
        "light them": light,
        "write them and read them back": disk,
        "export them as glTF": export,
    }
    checks: list[dict[str, Any]] = []
    for name, step in steps.items():
        start = perf_counter()
        try:
            step()
            fault = None
        except Exception as error:  # any failure is a finding
            fault = f"{type(error).__name__}: {error}"
        checks.append({"name": name, "seconds": perf_counter() - start, "fault": fault})
        if fault is not None:
            break
    return checks
