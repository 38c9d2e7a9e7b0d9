"""The page's export: a zip file of an export's folder."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from matcap.brdf.adjust import KEY, Adjustments, adjusted, parse_adjustments
from matcap.errors import UsageError
from matcap.view.subject import Maps, Materials, Viewable

_LARGEST = 4096  # texels a side


@dataclass(frozen=True)
class ExportRequest:
    """An export that the page asks for."""

    target: str
    """Target of `matcap export`: a document or a preset."""
    size: int
    """Sides in texels; ignored for a map set."""
    seed: int
    """Seed of the realisation."""
    share: float
    """Share of the second material, in [0, 1]."""
    adjust: Adjustments


def export_request(values: Mapping[str, str]) -> ExportRequest:
    """Parse query parameters.

    Raises:
        UsageError: a parameter is missing or invalid.
    """
    from matcap.export.targets import check_targets

    try:
        size, seed, share = (
            int(values["size"]), int(values.get("seed", "0")), float(values.get("share", "0"))
        )  # fmt: skip
        target = values["target"]
    except (KeyError, ValueError) as error:
        raise UsageError(
            "the request is not that of an export", remedy="give target, size and seed"
        ) from error
    if not 16 <= size <= _LARGEST or size % 16:
        raise UsageError(
            f"a size of {size} texels", remedy=f"give a multiple of 16 from 16 to {_LARGEST}"
        )
    if not 0.0 <= share <= 1.0:
        raise UsageError("the share is not between 0 and 1")
    # A link must not name a file of this machine.
    text = values.get("adjust", "")
    if text.lower().endswith(".json"):
        raise UsageError("adjustments cannot be a file here", remedy="give relief=1.3 or the like")
    return ExportRequest(check_targets([target])[0], size, seed, share, parse_adjustments(text))


def zipped(subject: Viewable, wish: ExportRequest) -> bytes:
    """Export a subject; return the bytes of a zip file.

    Raises:
        MatcapError: as write_export.
    """
    from matcap.export.job import ExportJob, known_scale
    from matcap.export.targets import write_export

    if isinstance(subject, Materials):
        material = subject.at(wish.share)
        side = wish.size
        period = None if side % material.alignment else (side, side)
        maps = material.maps(side, side, seed=wish.seed, period=period)
        provenance = dict(material.provenance)
    else:
        assert isinstance(subject, Maps)
        maps, provenance = subject.maps, {}
    if wish.adjust.changes:
        maps = adjusted(maps, wish.adjust)
        provenance[KEY] = wish.adjust.text
    name = subject.facts.name
    job = ExportJob(maps, name, known_scale(provenance), provenance=provenance)
    packed = io.BytesIO()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / f"{name}_{wish.target}"
        done = write_export(job, wish.target, folder)
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in done.files:
                archive.write(folder / file, f"{folder.name}/{file}")
    return packed.getvalue()
