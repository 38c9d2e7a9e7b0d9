"""`matcap bench report`: docs/notes/accuracy-and-time.md from the tables that the benches wrote.

The CSV of `matcap bench fronts` gets a section and a picture beside it; the JSON of `matcap bench
relight` a table. What stands below `BY_HAND` in the page is kept.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError
from matcap.files.staging import staged_file
from matcap.lab.bench.fronts_page import fronts_section

BY_HAND = "## What to make of it"


def write_report(tables: Sequence[Path], page: Path, command: Sequence[str]) -> str:
    """Write the page, and a picture beside every CSV; gives the page's text.

    Args:
        tables: CSV files of `matcap bench fronts`, and JSON files of `matcap bench relight`.
        page: where the text goes.
        command: that is writing it, for the page to tell.

    Raises:
        MatcapError: a table cannot be read or holds nothing, matplotlib is missing, or a file
            cannot be written.
    """
    lines = ["# What accuracy costs in time", "", "Written by:", "", f"    {shlex.join(command)}"]
    for table in tables:
        if not table.is_file():
            raise MatcapError("there is no such table", where=str(table), remedy="measure first")
        is_scenes = table.suffix == ".json"
        lines += ["", *(_relighting(table) if is_scenes else fronts_section(table, page))]
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    _, kept, by_hand = before.partition(f"{BY_HAND}\n")
    text = "\n".join(lines).rstrip() + "\n" + (f"\n{kept}{by_hand}" if kept else "")
    with staged_file(page) as file:
        file.write_text(text, encoding="utf-8")
    return text


def _relighting(table: Path) -> list[str]:
    """The table of a JSON file of `matcap bench relight`."""
    try:
        told: dict[str, Any] = json.loads(table.read_text(encoding="utf-8"))
        scenes = [
            f"| {one['scene']} | {one['effects']} | {one['automatic_s']:.3f} | {one['all_s']:.3f} "
            f"| {one['ratio']:.1f} |"
            for one in told["scenes"]
        ]
        flat = (
            f"One megapixel, one point light, flat: {told['megapixel_wall_ms']:.0f} ms. The plan "
            "leaves out what changes less than half an 8-bit step, and is "
            f"{told['median_ratio']:.1f} times as fast as all effects in the median scene."
        )
    except (KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise MatcapError(
            f"this is not what matcap bench relight --json prints ({error})",
            where=str(table),
            remedy="measure again",
        ) from error
    heads = "| scene | effects run | seconds by plan | seconds by all | ratio |"
    return ["## Relighting", "", flat, "", heads, "|---|---:|---:|---:|---:|", *scenes]
