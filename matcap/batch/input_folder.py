"""The photographs of an input folder, grouped by sample."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from matcap.capture.bracket import find_brackets
from matcap.capture.outputs import files_written
from matcap.errors import MatcapError
from matcap.files.names import series, usable_name
from matcap.files.quiet import quiet_decoders
from matcap.photo.exif import exif_tags
from matcap.photo.kind import RAW_SUFFIXES

Grouping = Literal["none", "name", "dir", "time"]
Taken = Callable[[Path], float | None]
Brackets = Callable[[Sequence[Path]], list[tuple[Path, ...]]]

_RAW = {".dng", *RAW_SUFFIXES}
_CAMERA = (".jpg", ".jpeg", ".heic", ".heif", ".hif", ".avif")  # that cameras write with a RAW
_OTHER = (".png", ".tif", ".tiff", ".webp", ".exr", ".hdr")
# Folders of thumbnails, trash and snapshots that network drives and systems create.
_NO_SHOOTS = frozenset({
    "@eadir", "@tmp", "@recycle", "@recently-snapshot", "#recycle", "#snapshot", "$recycle.bin",
    "__macosx", "system volume information", "lost+found",
    "thumbs", "thumbnails", "_thumbs", "_thumbnails",
})  # fmt: skip
_BRACKET_GAP = 5.0  # most seconds from one exposure of a bracket to the next
_PREVIEWS = (".lrdata", ".cocatalogdb")  # suffixes of photo catalogues' preview folders
# Parts that Pixel phones add to the names of one shot: PXL_x.RAW-01.COVER.jpg and
# PXL_x.RAW-02.ORIGINAL.dng; PXL_x.MP.jpg and PXL_x.dng.
_PIXEL = re.compile(r"\.(raw-\d+|mp|cover|original|night|ts|macro|portrait(-\d+)?)$")
WORKSPACE = ".matcap-batch"  # marks the output folder of a batch, which is not searched
# Material names whose files would collide with others in a material's folder.
_TAKEN = frozenset({"report", "preview", "matcap-batch"})


@dataclass(frozen=True)
class ShotSample:
    """The photographs of one material."""

    name: str
    """Name of the material and its folder; unique, ignoring case."""
    photos: tuple[Path, ...]
    """The photographs it is made from."""
    superseded: tuple[Path, ...] = ()
    """JPEG or HEIC files that are not used because a RAW file of the same shot exists."""


def find_samples(
    source: Path,
    *,
    group: Grouping = "none",
    gap: float = 10.0,
    without: Iterable[Path] = (),
    taken: Taken | None = None,
    brackets: Brackets = find_brackets,
) -> list[ShotSample]:
    """List the samples of an input folder, sorted by folder and name.

    Subfolders are searched, but for hidden ones, links, thumbnails (@eaDir and the like) and
    outputs of batches. Pictures of map sets and captures are no photographs. If a folder has a RAW
    and a JPEG of one shot (the same stem, or Pixel phones' names), the RAW is used.

    Args:
        group: photographs of one folder that are one sample: "none": each is its own; "name":
            those numbered alike (oak_1, oak_2); "dir": all; "time": those within `gap` seconds of
            the one before.
        gap: in seconds.
        without: files and folders to ignore.
        taken: time of a photograph in seconds, or None; by default from its Exif.
        brackets: groups photographs taken within seconds by place and exposure; each is a sample.

    Raises:
        MatcapError: there is no such folder, it may not be read, or it holds no photographs.
    """
    if not source.is_dir():
        what = "this is a file" if source.is_file() else "there is no such folder"
        raise MatcapError.at(source, what, "give a folder of photographs")
    passed_over = {path.resolve() for path in without}
    grouped: list[tuple[Path, ShotSample]] = []
    for folder, names in _folders(source, passed_over):
        written = files_written(names)
        files = [folder / name for name in names if name not in written]
        files = [file for file in files if file.resolve() not in passed_over]
        shots = _pairs(files)
        if not shots:
            continue
        place = inside = folder.relative_to(source)
        if group == "dir":
            runs = [shots]
        elif group == "time":
            runs = _runs(shots, gap, taken or taken_at)
        else:
            runs = _by_name(shots) if group == "name" else _bracketed(shots, taken, brackets)
        for run in runs:
            photos = tuple(photo for photo, _ in run)
            if group == "dir":
                label = "-".join(inside.parts) or source.resolve().name or "photographs"
            else:
                label = usable_name("-".join((*inside.parts, photos[0].stem)))
                place = inside / photos[0].name
            superseded = tuple(other for _, others in run for other in others)
            grouped.append((place, ShotSample(label, photos, superseded)))
    if not grouped:
        raise MatcapError.at(
            source,
            "there are no photographs in this folder",
            "give a folder of DNG, other RAW, JPEG, HEIC, AVIF, WebP, PNG, TIFF, EXR or HDR files",
        )
    return _named(grouped)


def taken_at(path: Path) -> float | None:
    """Time at which a photograph was taken, in seconds, from its Exif; None if it has none."""
    try:
        with path.open("rb") as file, quiet_decoders():
            text = str(exif_tags(file)["EXIF DateTimeOriginal"].values)
        return datetime.strptime(text, "%Y:%m:%d %H:%M:%S").timestamp()
    except (OSError, KeyError, AttributeError, ValueError, OverflowError):
        return None


_Shot = tuple[Path, tuple[Path, ...]]  # the photograph, and files of the same shot not used


def _folders(source: Path, passed_over: set[Path]) -> Iterator[tuple[Path, list[str]]]:
    def refuse(error: OSError) -> None:
        if Path(error.filename or "") == source:
            raise MatcapError.at(
                source, "the folder may not be read", "change its permissions"
            ) from error

    for root, folders, names in os.walk(source, onerror=refuse):
        folder = Path(root)
        if (folder / WORKSPACE).is_dir() and folder != source:
            folders.clear()
            continue
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".")
            and name.casefold() not in _NO_SHOOTS
            and not name.casefold().endswith(_PREVIEWS)
            and (folder / name).resolve() not in passed_over
        )
        yield folder, sorted(name for name in names if not name.startswith("."))


def _pairs(files: Sequence[Path]) -> list[_Shot]:
    """The photographs among the files of a folder; a RAW supersedes the JPEGs of its shot."""

    def kind(path: Path) -> str:
        return path.suffix.lower()

    raws = {_shot_of(path): path for path in files if kind(path) in _RAW}
    shots: list[_Shot] = []
    for path in files:
        raw = raws.get(_shot_of(path))
        if kind(path) in _RAW:
            superseded = [
                other
                for other in files
                if kind(other) in _CAMERA and _shot_of(other) == _shot_of(path)
            ]
            shots.append((path, tuple(superseded) if raw == path else ()))
        elif kind(path) in _OTHER or (kind(path) in _CAMERA and raw is None):
            shots.append((path, ()))
    return shots


def _shot_of(path: Path) -> str:
    """Name that all files of one shot share: the stem, without the parts Pixel phones add."""
    stem = path.stem.casefold()
    while stem.startswith("pxl_") and (cut := _PIXEL.sub("", stem)) != stem:
        stem = cut
    return stem


def _runs(shots: Sequence[_Shot], gap: float, taken: Taken) -> list[list[_Shot]]:
    """Shots in the order of time, split where two are more than `gap` seconds apart."""
    timed = [(taken(shot[0]), shot) for shot in shots]
    runs: list[list[_Shot]] = []
    last: float | None = None
    for when, shot in sorted(timed, key=lambda item: (item[0] is None, item[0] or 0.0, item[1][0])):
        if when is not None and last is not None and when - last <= gap:
            runs[-1].append(shot)
        else:
            runs.append([shot])
        last = when
    return sorted(runs, key=lambda run: run[0][0])


def _bracketed(
    shots: Sequence[_Shot], taken: Taken | None, brackets: Brackets
) -> list[list[_Shot]]:
    """Each shot alone, but for the exposures of brackets: neighbours in time by place and light."""
    every: list[list[_Shot]] = []
    for run in _runs(shots, _BRACKET_GAP, taken or taken_at):
        by_path = {shot[0]: shot for shot in run}
        groups = brackets(list(by_path)) if len(run) > 1 else [tuple(by_path)]
        every += [[by_path[path] for path in group] for group in groups]
    return sorted(every, key=lambda run: run[0][0])


def _by_name(shots: Sequence[_Shot]) -> list[list[_Shot]]:
    """Groups of shots whose names differ in a number only; other shots are single."""
    sets = series([shot[0].stem for shot in shots])
    taken = {position for each in sets for position in each}
    sets += [[position] for position in range(len(shots)) if position not in taken]
    return [[shots[position] for position in each] for each in sorted(sets, key=min)]


def _named(grouped: Sequence[tuple[Path, ShotSample]]) -> list[ShotSample]:
    """Give the samples unique names: equal ones get a hash of their own path appended.

    A photograph added later thus renames no other sample, unless their names collide.
    """
    count = Counter(sample.name.casefold() for _, sample in grouped)
    samples = []
    for place, sample in grouped:
        label = sample.name
        plain = label.lstrip(".") or "photograph"
        if count[label.casefold()] > 1 or plain.casefold() in _TAKEN or plain != label:
            plain += "-" + hashlib.sha256(place.as_posix().encode()).hexdigest()[:6]
        samples.append(replace(sample, name=plain))
    return samples
