"""`matcap doctor`: versions, devices and a self-test of this installation, for bug reports."""

from __future__ import annotations

import platform
import re
import tempfile
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from matcap.cli.options import JsonOption
from matcap.errors import ExitCode, MatcapError

_SIDE = 256  # texels of the self-test's maps


def doctor(
    json: JsonOption = False,
    self_test: Annotated[
        bool,
        typer.Option("--self-test/--no-self-test", help="Also run a small material to a picture."),
    ] = True,
) -> None:
    """Print versions, devices and extras, and test whether all of it works.

    Exits with 3 if something is missing or broken.
    """
    report = diagnose(self_test=self_test)
    if json:
        from json import dumps

        typer.echo(dumps(report, indent=2))
    else:
        typer.echo(as_text(report))
    raise typer.Exit(ExitCode.DONE if report["healthy"] else ExitCode.NOTHING_SUCCEEDED)


def diagnose(*, self_test: bool = True) -> dict[str, Any]:
    """Versions, devices and packages for JSON, without raising.

    `packages`: version of each that is needed, or null. `extras`: the same by extra. `compiled`:
    whether the inner loops are built, without which fields by example and relighting cannot run.
    `self_test`: `fault`, or null, and `seconds`; null where it was not run. `healthy`: whether all
    that is needed is installed and the self-test passed.
    """
    from matcap.example import library as example_loops
    from matcap.files.names import MAKER_VERSION
    from matcap.files.process import cores
    from matcap.relight.loops import library as relighting_loops

    needed, extras = _requirements()
    whole = all(needed.values())
    test = _self_test() if self_test and whole else None
    return {
        "matcap": MAKER_VERSION,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "place": str(Path(__file__).parents[1]),
        "cores": cores(),
        "devices": _devices(),
        "compiled": None not in (example_loops.built(), relighting_loops.built()),
        "packages": needed,
        "extras": extras,
        "self_test": test,
        "healthy": whole and (test is None or test["fault"] is None),
    }


def as_text(report: dict[str, Any]) -> str:
    """A diagnosis as text."""
    built = "compiled" if report["compiled"] else "not built: install again with a C compiler"
    lines = [
        f"matcap {report['matcap']} in {report['place']}",
        f"Python {report['python']}, {report['system']}, {report['cores']} cores",
        f"devices: {', '.join(report['devices']) or 'unknown'}; inner loops: {built}",
        *(f"  {name:<32} {has or 'MISSING'}" for name, has in report["packages"].items()),
    ]
    for extra, parts in report["extras"].items():
        listed = ", ".join(f"{name} {has or 'missing'}" for name, has in parts.items())
        install = "" if all(parts.values()) else f'; to install it: pip install "matcap[{extra}]"'
        lines.append(f"extra {extra}: {listed}{install}")
    if report["self_test"] is not None:
        test = report["self_test"]
        lines.append(f"self-test: {test['fault'] or 'ok'}, {test['seconds']:.1f} s")
    return "\n".join([*lines, "All is well." if report["healthy"] else "Something is wrong."])


def _requirements() -> tuple[dict[str, str | None], dict[str, dict[str, str | None]]]:
    """Versions of needed packages and of each extra's, as the installed metadata state them."""
    groups: dict[str, dict[str, str | None]] = {"": {}}
    for requirement in _or_none(requires) or []:
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", requirement)
        groups.setdefault(extra[1] if extra else "", {})[name] = _or_none(version, name)
    groups.pop("dev", None)
    return groups.pop(""), groups


def _or_none(of: Any, name: str = "matcap") -> Any:  # noqa: ANN401
    try:
        return of(name)
    except PackageNotFoundError:
        return None


def _devices() -> list[str]:
    """Devices that torch can use; empty where torch cannot be loaded."""
    try:
        import torch
    except (ImportError, OSError):
        return []
    return ["cpu", *(torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count()))]


def _self_test() -> dict[str, Any]:
    """Draw a material from the prior, write its maps, read, light and export them."""
    began, fault = perf_counter(), None
    try:
        from matcap.api import relight
        from matcap.export.targets import export_mapset
        from matcap.field.opened import open_tile
        from matcap.field.plane import Rectangle
        from matcap.space.prior.store import load_prior
        from matcap.synth.request import SynthRequest
        from matcap.synth.stream import synthesise

        with tempfile.TemporaryDirectory() as folder:
            material, place = load_prior().draw(0), Path(folder) / "set"
            maps = material.maps(_SIDE, _SIDE, seed=0)
            if not 0.0 < float(relight(maps, "top").mean()) < 1e3:
                raise MatcapError("the picture is black or not finite")
            synthesise(SynthRequest(material, Rectangle(0, 0, _SIDE, _SIDE), device="cpu"), place)
            if (open_tile(place).maps.height != maps.height).any():
                raise MatcapError("a map set changed when written and read again")
            export_mapset(place, "gltf")
    except Exception as error:  # any failure is a finding
        fault = f"{type(error).__name__}: {error}"
    return {"fault": fault, "seconds": perf_counter() - began}
