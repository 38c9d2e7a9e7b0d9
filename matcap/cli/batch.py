"""`matcap batch`: all photographs of a folder."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.batch.samples import BatchSettings
from matcap.capture.settings import CaptureSettings, OutputSettings
from matcap.cli.options import (
    ADVANCED,
    NOTHING,
    Fields,
    Given,
    JsonOption,
    OverwriteOption,
    QuietOption,
    StrictOption,
    with_settings,
)
from matcap.errors import ExitCode

if TYPE_CHECKING:
    from matcap.batch.work import BatchEntry


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
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Capture again what is already captured.", rich_help_panel=ADVANCED
        ),
    ] = False,
    retry_failed: Annotated[
        bool,
        typer.Option(
            "--retry-failed", help="Capture again what failed before.", rich_help_panel=ADVANCED
        ),
    ] = False,
    fail_fast: Annotated[
        bool,
        typer.Option("--fail-fast", help="End at the first failure.", rich_help_panel=ADVANCED),
    ] = False,
    overwrite: OverwriteOption = False,
    strict: StrictOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn all photographs of a folder into materials; resumes an earlier run.

    Settings come from matcap.toml in or next to the folder; options override it. The results are
    listed in index.html in the output folder.
    """
    from matcap.batch.run import prepare, work_off
    from matcap.batch.samples import settings_of
    from matcap.batch.work import Policy
    from matcap.capture.time_limit import slowness, within_time
    from matcap.cli.display import BatchDisplay

    settings = settings_of(source, given)
    if settings.capture.time_limit is not None:
        within_time(settings.capture, 1, slowness())  # refuses what no capture can keep
    policy = Policy(force, retry_failed, fail_fast, strict, overwrite)
    with BatchDisplay.open(quiet=quiet) as shown:
        if scheduler:  # workers have other current folders
            source, out = source.resolve(), out.resolve()
        prepared = prepare(source, out, settings, policy, shown)
        if dry_run:
            from matcap.batch.run import predict

            prediction = predict(prepared)
        else:
            try:
                code = work_off(prepared, policy, shown, scheduler)
            except KeyboardInterrupt:
                code = ExitCode.INTERRUPTED
    if dry_run:
        _print_prediction(prepared.entries, prediction, as_json=as_json)
        raise typer.Exit(ExitCode.DONE)
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
