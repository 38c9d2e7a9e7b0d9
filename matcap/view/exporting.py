"""The page's export: a zip file of an export's folder."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from matcap.brdf.adjust import KEY, adjusted, parse_adjustments
from matcap.errors import UsageError
from matcap.files.settings import known
from matcap.view.subject import Maps, Materials, Viewable

_LARGEST = 4096  # texels a side


def seed_and_share(values: Mapping[str, str]) -> tuple[int, float]:
    """Seed, and share of the second material, of a query; both are 0 by default.

    Raises:
        ValueError: one of them is not a number.
        UsageError: the share is not between 0 and 1.
    """
    share = float(values.get("share", "0"))
    if not 0.0 <= share <= 1.0:
        raise UsageError("the share is not between 0 and 1")
    return int(values.get("seed", "0")), share


def exported(subject: Viewable, values: Mapping[str, str]) -> tuple[str, bytes]:
    """Export a subject as the page asks for; return the target and the bytes of a zip file.

    Args:
        values: of the query: `target` of `matcap export`, `size` of a material's square in texels,
            `seed`, `share` of the second material, `adjust`.

    Raises:
        UsageError: a parameter is missing or invalid.
        MatcapError: as write_export.
    """
    from matcap.export.job import ExportJob, known_scale
    from matcap.export.targets import TARGETS, write_export

    try:
        size, wanted = int(values["size"]), values["target"]
        seed, share = seed_and_share(values)
    except (KeyError, ValueError) as error:
        raise UsageError(
            "the request is not that of an export", remedy="give target, size and seed"
        ) from error
    if not 16 <= size <= _LARGEST or size % 16:
        raise UsageError(
            f"a size of {size} texels", remedy=f"give a multiple of 16 from 16 to {_LARGEST}"
        )
    # A link must not name a file of this machine.
    text = values.get("adjust", "")
    if text.lower().endswith(".json"):
        raise UsageError("adjustments cannot be a file here", remedy="give relief=1.3 or the like")
    target, adjust = known(wanted, TARGETS, "--export"), parse_adjustments(text)
    if isinstance(subject, Materials):
        material = subject.at(share)
        period = None if size % material.alignment else (size, size)
        maps = material.maps(size, size, seed=seed, period=period)
        provenance = dict(material.provenance)
    else:
        assert isinstance(subject, Maps)
        maps, provenance = subject.maps, {}
    if adjust.changes:
        maps = adjusted(maps, adjust)
        provenance[KEY] = adjust.text
    name = subject.facts.name
    job = ExportJob(maps, name, known_scale(provenance), provenance=provenance)
    packed = io.BytesIO()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / f"{name}_{target}"
        done = write_export(job, target, folder)
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in done.files:
                archive.write(folder / file, f"{folder.name}/{file}")
    return target, packed.getvalue()
