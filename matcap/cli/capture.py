"""`matcap capture` and `matcap batch`: photographs to materials."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.batch.samples import BatchSettings, Policy
from matcap.capture.settings import (
    CaptureSettings,
    OutputSettings,
    check_photographs,
    slowness,
    within_time,
)
from matcap.cli.options import (
    ADVANCED,
    NOTHING,
    SEVERAL,
    Fields,
    Given,
    JsonOption,
    OverwriteOption,
    QuietOption,
    StrictOption,
    chosen,
    with_settings,
)
from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.files.names import Note, usable_name

if TYPE_CHECKING:
    from matcap.batch.work import BatchEntry
    from matcap.cli.display import CaptureDisplay


@dataclass(frozen=True)
class _Job:
    photo: Path
    folder: Path
    others: tuple[Path, ...] = ()


@with_settings
def capture(
    photos: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTO...", help="RAW, JPEG, HEIC, AVIF, WebP, PNG, TIFF, EXR or HDR."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Each photograph gets a folder here.")
    ] = Path("out"),
    given: Annotated[Given, Fields(CaptureSettings, OutputSettings)] = NOTHING,
    together: Annotated[
        bool,
        typer.Option(
            "--together",
            help="Make one material of all photographs: they show the same sample from several "
            "places. It is made in the frame of the first photograph, or of a better one, and "
            "under the first one's name.",
            rich_help_panel=SEVERAL,
        ),
    ] = False,
    overwrite: OverwriteOption = False,
    strict: StrictOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn flash photographs into materials.

    Writes the material (.matcap), a first map set (EXR), preview.png and report.json, and prints a
    verdict. Photographs from one place, a stop or more apart in exposure, make one material.
    """
    from matcap.capture.bracket import MOST, find_brackets, unmerged
    from matcap.cli.display import CaptureDisplay
    from matcap.files.output import check_writable

    settings = chosen(CaptureSettings, given)
    outputs = chosen(OutputSettings, {**given, "seed": settings.seed})
    check_photographs(settings, len(photos) if together else 1)
    if together and len(photos) < 2:
        raise UsageError.at(
            "--together", "there is one photograph", "give two or more of one sample"
        )
    if settings.time_limit is not None:
        settings = within_time(settings, len(photos) if together else 1, slowness())
    photos = photos if together else _once(photos)
    samples = [tuple(photos)] if together else find_brackets(photos, fov=settings.fov)
    jobs = _jobs(samples, out)
    check_writable(out, outputs.room)
    results = []
    with CaptureDisplay.open(quiet=quiet) as shown:
        # More are a shoot of samples, each at an exposure of its own.
        for one, other in unmerged(samples) if len(photos) <= MOST else ():
            shown.note(
                f"{other.name}: not merged with {one.name}, which shows another place or light"
            )
        for job in jobs:
            # Time before the first photograph counts as the process's start.
            spent = time.process_time() if job is jobs[0] else 0.0
            results.append(_attempt(job, settings, outputs, shown, spent, overwrite=overwrite))
            if results[-1]["status"] == "interrupted":
                break
    if as_json:
        typer.echo(json.dumps({"photographs": results}, indent=2))
    states = [_state(result, strict=strict) for result in results]
    done = ExitCode.of(states.count("done"), len(states))
    raise typer.Exit(ExitCode.INTERRUPTED if "interrupted" in states else done)


def _once(photos: Sequence[Path]) -> list[Path]:
    """The photographs, each once; a note names those given again."""
    once = {os.path.abspath(photo): photo for photo in reversed(photos)}
    counts = Counter(os.path.abspath(photo) for photo in photos)
    for path in (path for path, times in counts.items() if times > 1):
        warnings.warn(f"{once[path]}: given more than once, captured once", Note, stacklevel=2)
    return [once[path] for path in counts]


def _jobs(samples: Sequence[Sequence[Path]], out: Path) -> list[_Job]:
    """A folder for each sample, named as its first photograph; a second one of the same stem gets
    a number.
    """
    taken: set[str] = set()
    jobs = []
    for photo, *others in samples:
        stem = name = usable_name(photo.stem.lstrip(".") or "photograph", "photograph")
        number = 1
        while name.casefold() in taken:
            number += 1
            name = f"{stem}-{number}"
        taken.add(name.casefold())
        jobs.append(_Job(photo, out / name, tuple(others)))
    return jobs


def _attempt(
    job: _Job,
    settings: CaptureSettings,
    outputs: OutputSettings,
    shown: CaptureDisplay,
    spent: float,
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Capture one photograph; a failure is a result too."""
    from matcap.capture.report import output_files
    from matcap.files.output import check_output

    started = time.perf_counter()
    try:
        files = [job.folder / name for name in output_files(job.folder.name)]
        check_output(files, inputs=[job.photo, *job.others], overwrite=overwrite)
        done = _capture(job, settings, outputs, shown, spent)
    except UsageError:
        raise  # wrong for every photograph alike
    except MatcapError as error:
        shown.failed(job.photo, str(error))
        return {"photo": str(job.photo), "status": "failed", "reason": str(error)}
    except KeyboardInterrupt:
        reason = "interrupted before there was anything to save"
        shown.failed(job.photo, f"{job.photo}: {reason}.")
        return {"photo": str(job.photo), "status": "interrupted", "reason": reason}
    done["seconds"] = round(time.perf_counter() - started, 2)
    shown.finished(job.photo, done)
    return done


def _capture(
    job: _Job,
    settings: CaptureSettings,
    outputs: OutputSettings,
    shown: CaptureDisplay,
    spent: float,
) -> dict[str, Any]:
    began = time.perf_counter()
    from matcap.capture.report import level_notes, no_repeat, set_warnings
    from matcap.capture.run import capture_into
    from matcap.files.process import returning_memory

    spent += time.perf_counter() - began
    shown.started(job.photo)
    photos = (job.photo, *job.others)
    progress = returning_memory(shown.progress)
    result = capture_into(job.folder, photos, settings, outputs, progress, spent)
    alignment = result.material.alignment
    if not outputs.repeats(alignment):
        shown.note(no_repeat(outputs.size, alignment))
    return {
        "photo": str(job.photo),
        "status": result.status.value,
        "folder": str(job.folder),
        "material": str(job.folder / f"{job.folder.name}.matcap"),
        "verdict": result.verdict.document(),
        "error": result.errors,
        "notes": [*set_warnings(result), *result.photo.remarks, *level_notes(result)],
    }


def _state(result: dict[str, Any], *, strict: bool) -> str:
    """State that determines the exit code: the outcome and, with --strict, the verdict."""
    state: str = result["status"]
    return "failed" if state == "done" and strict and not result["verdict"]["fit"] else state


# `matcap batch`: all photographs of a folder.


@with_settings
def batch(
    source: Annotated[Path, typer.Argument(metavar="FOLDER", help="A folder of photographs.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Each sample gets a folder here.")
    ] = Path("materials"),
    given: Annotated[Given, Fields(CaptureSettings, OutputSettings, BatchSettings)] = NOTHING,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a dask scheduler, tcp://host:8786.",
            rich_help_panel=ADVANCED,
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only print the plan, its time and its disk space.")
    ] = False,
    chosen_policy: Annotated[Given, Fields(Policy)] = NOTHING,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn all photographs of a folder into materials; resumes an earlier run.

    Settings come from matcap.toml in or next to the folder; options override it. The results are
    listed in index.html in the output folder.
    """
    from matcap.batch.run import predict, prepare, work_off
    from matcap.batch.samples import settings_of
    from matcap.cli.display import BatchDisplay

    settings = settings_of(source, given)
    if settings.capture.time_limit is not None:
        within_time(settings.capture, 1, slowness())  # refuses what no capture can keep
    policy = chosen(Policy, chosen_policy)
    with BatchDisplay.open(quiet=quiet) as shown:
        if scheduler:  # workers have other current folders
            source, out = source.resolve(), out.resolve()
        prepared = prepare(source, out, settings, policy, shown)
        try:
            code = ExitCode.DONE if dry_run else work_off(prepared, policy, shown, scheduler)
        except KeyboardInterrupt:
            code = ExitCode.INTERRUPTED
    if dry_run:
        _print_prediction(prepared.entries, predict(prepared), as_json=as_json)
        raise typer.Exit(code)
    _print_results(prepared.entries, out, as_json=as_json, quiet=quiet)
    if code == ExitCode.INTERRUPTED and all(e.state != "left" for e in prepared.entries):
        typer.echo("matcap: interrupted after the last sample was finished.", err=True)
    raise typer.Exit(code)


def _print_results(entries: Sequence[BatchEntry], out: Path, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        rows = [_document(entry, out) for entry in entries]
        typer.echo(json.dumps({"out": str(out), "materials": rows}, indent=2))
    counts = Counter(entry.state for entry in entries)
    doubtful = [entry.sample.name for entry in entries if entry.record.get("doubtful")]
    if not quiet:
        counted = [f"{counts['made']} made", f"{counts['kept']} done before"]
        counted += [f"{counts[state]} {state}" for state in ("failed", "left") if counts[state]]
        typer.echo(f"{', '.join(counted)}; see {out / 'index.html'}", err=True)
        if doubtful:
            more = f" and {len(doubtful) - 8} more" if len(doubtful) > 8 else ""
            names = f"{', '.join(doubtful[:8])}{more}"
            typer.echo(f"{len(doubtful)} doubtful: {names}", err=True)
    failed, left = ([e.reason for e in entries if e.state == state] for state in ("failed", "left"))
    for reason in failed:
        typer.echo(f"matcap: {reason}", err=True)
    if left:
        typer.echo(f"matcap: {len(left)} not begun: {left[0]}.", err=True)


def _document(entry: BatchEntry, out: Path) -> dict[str, Any]:
    return {
        "name": entry.sample.name,
        "photographs": [str(photo) for photo in entry.sample.photos],
        "status": {"made": "done", "kept": "done before"}.get(entry.state, entry.state),
        "folder": str(out / entry.sample.name),
        "doubtful": bool(entry.record.get("doubtful")),
        "verdict": (entry.record.get("verdict") or {}).get("rating"),
        "error": entry.record.get("error"),
        "seconds": entry.record.get("seconds"),
        "reason": entry.reason or None,
    }


def _print_prediction(
    entries: Sequence[BatchEntry], prediction: dict[str, Any], *, as_json: bool
) -> None:
    from matcap.batch.run import prediction_text

    if as_json:
        typer.echo(json.dumps(prediction, indent=2))
        return
    for entry in entries:
        state = {"todo": "to do", "kept": "done", "failed": "cannot be used"}[entry.state]
        photos = ", ".join(photo.name for photo in entry.sample.photos)
        typer.echo(f"{entry.sample.name}: {state} ({entry.reason or photos})")
    typer.echo(prediction_text(prediction))
