"""`matcap inspect`: the quality of photographs with advice, and a summary of a material."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.capture.settings import CaptureSettings, InspectSettings
from matcap.cli.options import NOTHING, Fields, Given, JsonOption, chosen, with_settings
from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.photo.checks import Finding, Rating

if TYPE_CHECKING:
    from matcap.photo.inspect import Inspection

_MARKS = {"good": "ok", "not judged": "  ", "usable": "- ", "doubtful": "? ", "failed": "! "}


@with_settings
def inspect(
    photos: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTO...",
            help="RAW (DNG, ...), JPEG, HEIC, AVIF, WebP, PNG, TIFF, EXR or HDR, a folder of them, "
            "or a material (.matcap or its folder).",
        ),
    ],
    given: Annotated[Given, Fields(InspectSettings)] = NOTHING,
    captured: Annotated[Given, Fields(CaptureSettings, only=("fov", "white"))] = NOTHING,
    as_json: JsonOption = False,
) -> None:
    """Rate photographs before they are captured, with advice for the next one.

    Checks whether there is a lit, flat material, and flash, clipping, highlight, tilt, sharpness
    and uniformity. Of several photographs it prints a line for each: "-" usable, "?" doubtful, "!"
    failed. Up to five are merged as by capture, where they are exposures from one place. Of several
    of one sample it reports which cannot be registered, which sides no photograph lights, and which
    are nearly the same. Of a material it prints its exemplar, its F0 and its verdict.
    """
    from matcap.cli.display import working
    from matcap.files.names import are_a_series

    detail, details, together = astuple(chosen(InspectSettings, given))
    photos = _files(photos)
    fov, white = captured.get("fov"), captured.get("white")
    pictures = [path for path in photos if path.suffix.lower() != ".matcap"]
    if together and not pictures:
        raise UsageError.at("--together", "there are no photographs", "name two or more")
    others = _exposures(pictures, fov)
    merged = {path for each in others.values() for path in each}
    pictures = [path for path in pictures if path not in merged]
    several = len(pictures) > 1
    photographs: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    seen: list[tuple[str, Inspection, list[str]]] = []
    failures = 0
    for path in (path for path in photos if path not in merged):
        of_material = path.suffix.lower() == ".matcap"
        documents = materials if of_material else photographs
        kind = "material" if of_material else "photo"
        try:
            with working(f"inspecting {path.name}", quiet=as_json):
                if of_material:
                    document, text = _material(path)
                else:
                    dark = others.get(path, ())
                    document, quality, more = _photo(path, detail, fov, white, dark)
        except UsageError:
            raise
        except MatcapError as error:
            failures += 1
            documents.append({kind: str(path), "reason": str(error)})
            typer.echo(f"matcap: {error}", err=True)
            continue
        documents.append({kind: str(path), **document})
        if not of_material:
            ended = "".join(f" + {each.name}" for each in dark)
            text = _briefly(f"{path.name}{ended}", quality)
            seen.append((f"{path}{ended}", quality, more))
        if not as_json and (of_material or (several and not details)):
            typer.echo(text)
    if not as_json:
        shared = _shared([quality for _, quality, _ in seen])
        for name, quality, more in seen if details or not several else ():
            typer.echo("\n".join(_rated(name, quality, shared) + more))
        for finding in shared:
            if details or (finding.remedy and finding.rating is Rating.NOT_JUDGED):
                typer.echo(f"   all: {finding.line()}")
    summary: dict[str, Any] = {"photographs": photographs}
    summary |= {"materials": materials} if materials else {}
    if together if together is not None else are_a_series([path.stem for path in pictures]):
        from matcap.capture.inspection import coverage_of_files

        try:
            with working("comparing the photographs", quiet=as_json):
                quality = coverage_of_files(pictures, fov)
        except MatcapError as error:
            failures += 1
            summary["together"] = {"reason": str(error)}
            typer.echo(f"matcap: {error}", err=True)
        else:
            summary["together"] = quality.document()
            if not as_json:
                typer.echo("\n".join(_rated(f"{len(pictures)} photographs together", quality)))
    if as_json:
        typer.echo(json.dumps(summary, indent=2, allow_nan=False))
    if failures:
        some = len(photographs) + len(materials) > sum(
            "reason" in d for d in photographs + materials
        )
        raise typer.Exit(ExitCode.SOME_FAILED if some else ExitCode.NOTHING_SUCCEEDED)


def _files(paths: Sequence[Path]) -> list[Path]:
    """The paths, folders replaced by their material, or by the photographs in them.

    Raises:
        MatcapError: a folder without photographs.
    """
    from matcap.batch.samples import find_samples

    files: list[Path] = []
    for path in paths:
        if not path.is_dir():
            files.append(path)
        elif materials := sorted(path.glob("*.matcap")):
            files += materials
        else:
            samples = find_samples(path, group="none")
            files += [photo for sample in samples for photo in sample.photos]
    return files


def _exposures(pictures: Sequence[Path], fov: float | None) -> dict[Path, Sequence[Path]]:
    """The exposures that are merged with each photograph, of few; more are a shoot."""
    if len(pictures) < 2:
        return {}
    from matcap.capture.bracket import MOST, find_brackets

    if len(pictures) > MOST:
        return {}
    return {group[0]: group[1:] for group in find_brackets(pictures, fov=fov)}


def _briefly(name: str, quality: Inspection) -> str:
    """A line on a photograph: its rating, and what limits it most."""
    line = f"{_MARKS[quality.rating.value]} {name}: {quality.rating.value}"
    subject = quality["subject"]
    if subject.rating is not Rating.GOOD:
        return f"{line}: {subject.line()}"
    rated = [one for one in quality.findings if one.rating is quality.rating]
    if quality.rating is Rating.GOOD or not rated:
        return line
    return f"{line}: {max(rated, key=lambda one: one.severity).line()}"


def _shared(photographs: Sequence[Inspection]) -> list[Finding]:
    """Findings that all of several photographs have alike, without those that are good."""
    if len(photographs) < 2:
        return []
    lines = [{one.line() for one in quality.findings} for quality in photographs]
    first = photographs[0].findings
    return [
        one
        for one in first
        if one.rating is not Rating.GOOD and all(one.line() in each for each in lines)
    ]


def _photo(
    path: Path, detail: int, fov: float | None, white: float | None, others: Sequence[Path]
) -> tuple[dict[str, Any], Inspection, list[str]]:
    """Checks of a photograph for JSON, and themselves, with lines of what else is measured."""
    from matcap.capture.inspection import inspect_file, inspected
    from matcap.capture.run import read_exposures

    if others:
        settings = CaptureSettings(detail=detail, fov=fov, white=white)
        seen = inspected(read_exposures((path, *others), settings, several=False))
    else:
        seen = inspect_file(path, detail, fov, white)
    quality, relief = seen.quality, seen.relief_spectrum
    spectrum = relief.document() if relief else None
    lines = [f"     {name:<13} {says}" for name, says in _spectrum_lines(spectrum)]
    document = quality.document() | {"relief_spectrum": spectrum, "tilt_sources": seen.tilt}
    if others:
        document["exposures"] = [each.name for each in (path, *others)]
    return document, quality, lines


def _rated(name: str, quality: Inspection, shared: Sequence[Finding] = ()) -> list[str]:
    """Lines of an inspection: its rating, and a line a finding but those of all photographs."""
    shared_lines = {one.line() for one in shared}
    findings = (
        f"{_MARKS[one.rating.value]} {one.name:<13} {one.line()}"
        for one in quality.findings
        if one.line() not in shared_lines
    )
    return [f"{name}: {quality.rating.value}", *(f"  {finding}" for finding in findings)]


def _spectrum_lines(measured: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Contrast of relief and albedo in words."""
    if measured is None:
        return []
    bands = measured["bands"]

    def finest(of: str) -> str:
        low, high = sorted(max(bands, key=lambda band: float(band[of]))["wavelengths"])
        return f"mostly in details of {low / 2:g} to {high / 2:g} pixels"

    steep = math.degrees(math.atan(math.hypot(*(band["slope"] for band in bands))))
    varies = 100.0 * math.expm1(math.hypot(*(band["albedo"] for band in bands)))
    return [
        ("relief", f"Slopes of about {steep:.0f} degrees, {finest('slope')}."),
        ("albedo", f"Its lightness varies by about {varies:.0f} %, {finest('albedo')}."),
    ]


def _material(path: Path) -> tuple[dict[str, Any], str]:
    """Summary of a material, for JSON and as text."""
    from matcap.capture.report import REPORT, read_report
    from matcap.example.example import read_exemplified, summary
    from matcap.export.job import known_scale

    exemplified, made = read_exemplified(path), "by example"
    if exemplified is None:
        exemplified, made = read_exemplified(path, "drawing"), "a decoder that reads a drawing"
    if exemplified is None:
        return {"exemplar": None}, f"{path}: a decoder without an exemplar"
    about = summary(exemplified.example)
    lines = [
        f"     {name:<13} {says}" for name, says in about.lines(known_scale(exemplified.provenance))
    ]
    document: dict[str, Any] = {"exemplar": about.document()}
    report = read_report(path.parent / REPORT) or {}
    verdict, photographed = report.get("verdict"), report.get("photograph", {}).get("name")
    own = photographed == exemplified.provenance.get("photograph")
    if own and isinstance(verdict, dict) and "sentence" in verdict:
        checks = verdict.get("checks", {})
        document["verdict"] = verdict
        lines.append(f"     {'verdict':<13} {verdict['sentence']}")
        if "highlight_contrast" in checks:
            lines.append(f"     {'highlight':<13} {checks['highlight_contrast']['message']}")
    return document, "\n".join([f"{path}: {made}", *lines])
