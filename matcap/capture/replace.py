"""Overwrite rule of batches: a capture is not replaced by one of less effort."""

from __future__ import annotations

from pathlib import Path

from matcap.capture.outputs import REPORT
from matcap.capture.report_file import read_report
from matcap.capture.settings import CaptureSettings, resolve
from matcap.errors import MatcapError


def refuse_to_replace_longer_capture(
    folder: Path, settings: CaptureSettings, photographs: int
) -> None:
    """Raise if a folder has a capture of more photographs, texels or steps.

    Args:
        folder: output folder of the new capture.
        settings: of the new capture.
        photographs: number of its photographs.

    Raises:
        MatcapError: states the old effort and names --overwrite.
    """
    old = read_report(folder / REPORT)
    if old is None or old.get("interrupted"):
        return
    before = len((old.get("multi_view") or {}).get("photographs", ())) or 1
    spent, effort = old.get("effort", {}), resolve(settings)
    # `effort` may hold the preset's detail, so that `settings` comes first.
    detail = old.get("settings", {}).get("detail") or spent.get("detail", 0)
    if before > photographs:
        earlier = f"one of {before} photographs"
    elif detail > effort.detail or spent.get("steps", 0) > effort.steps:
        earlier = f"a longer one, of preset {spent.get('preset')}"
    else:
        return
    raise MatcapError.at(
        folder,
        f"the folder has an earlier capture ({earlier})",
        "choose another folder with -o, or give --overwrite",
    )
