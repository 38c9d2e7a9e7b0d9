"""Samples of a batch: photographs of the input folder, the hash of their inputs, and settings."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from matcap.capture.settings import CaptureSettings, OutputSettings, prior_file
from matcap.errors import MatcapError, UsageError
from matcap.files.names import MAKER_VERSION, series, usable_name
from matcap.files.process import quiet_decoders
from matcap.files.settings import (
    CheckedSettings,
    Setting,
    nearest,
    setting,
    settings_in,
    typed_settings,
)

# The photographs of an input folder, grouped by sample.

Grouping = Literal["none", "name", "dir", "time"]

# That cameras write with a RAW; .jfif and .jpe are JPEGs as browsers save them.
_CAMERA = (".jpg", ".jpeg", ".jpe", ".jfif", ".heic", ".heif", ".hif", ".avif")
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
    source: Path, *, group: Grouping = "none", gap: float = 10.0, without: Iterable[Path] = ()
) -> list[ShotSample]:
    """List the samples of an input folder, sorted by folder and name.

    Subfolders are searched, but for hidden ones, links, thumbnails (@eaDir and the like) and
    outputs of batches. Pictures of map sets and captures are no photographs. If a folder has a RAW
    and a JPEG of one shot (the same stem, or Pixel phones' names), the RAW is used. Photographs
    on their own that are exposures of one place, taken within seconds, are one sample.

    Args:
        group: photographs of one folder that are one sample: "none": each is its own; "name":
            those numbered alike (oak_1, oak_2); "dir": all; "time": those within `gap` seconds of
            the one before.
        gap: in seconds.
        without: files and folders to ignore.

    Raises:
        MatcapError: there is no such folder, it may not be read, or it holds no photographs.
    """
    if not source.is_dir():
        what = "this is a file" if source.is_file() else "there is no such folder"
        raise MatcapError.at(source, what, "give a folder of photographs")
    # Importing these takes long, and the command line imports this file at its start.
    from matcap.capture.report import files_written

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
            runs = _runs(shots, gap)
        else:
            runs = _by_name(shots) if group == "name" else [[shot] for shot in shots]
            single = [run[0] for run in runs if len(run) == 1]
            runs = [run for run in runs if len(run) > 1] + _bracketed(single)
            runs.sort(key=lambda run: run[0][0])
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
        from matcap.photo.exif import exif_tags

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
    from matcap.photo.load import RAW_SUFFIXES

    def kind(path: Path) -> str:
        return path.suffix.lower()

    raw_suffixes = {".dng", *RAW_SUFFIXES}
    raws = {_shot_of(path): path for path in files if kind(path) in raw_suffixes}
    shots: list[_Shot] = []
    for path in files:
        raw = raws.get(_shot_of(path))
        if kind(path) in raw_suffixes:
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


def _runs(shots: Sequence[_Shot], gap: float) -> list[list[_Shot]]:
    """Shots in the order of time, split where two are more than `gap` seconds apart."""
    timed = [(taken_at(shot[0]), shot) for shot in shots]
    runs: list[list[_Shot]] = []
    last: float | None = None
    for when, shot in sorted(timed, key=lambda item: (item[0] is None, item[0] or 0.0, item[1][0])):
        if when is not None and last is not None and when - last <= gap:
            runs[-1].append(shot)
        else:
            runs.append([shot])
        last = when
    return sorted(runs, key=lambda run: run[0][0])


def _bracketed(shots: Sequence[_Shot]) -> list[list[_Shot]]:
    """Each shot alone, but for the exposures of brackets: neighbours in time by place and light."""
    from matcap.capture.bracket import find_brackets

    every: list[list[_Shot]] = []
    for run in _runs(shots, _BRACKET_GAP):
        by_path = {shot[0]: shot for shot in run}
        groups = find_brackets(list(by_path)) if len(run) > 1 else [tuple(by_path)]
        every += [[by_path[path] for path in group] for group in groups]
    return every


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


# Settings of a batch: matcap.toml in or next to the input folder, overridden by options.

FILE = "matcap.toml"
_MOST_BYTES = 1_000_000  # limit of a settings file


@dataclass(frozen=True)
class BatchSettings(CheckedSettings):
    """Settings of a batch, and of the captures in it."""

    capture: CaptureSettings = CaptureSettings()
    """Settings of every capture."""
    outputs: OutputSettings = OutputSettings()
    """Settings of every capture's outputs."""
    group: str = setting("name", words=("none", "name", "dir", "time"), group="Several photographs")
    """Which photographs show one sample."""
    gap: float = setting(10.0, least=0.0, most=1e9, group="Several photographs")
    """Seconds between two shots of one sample, with group time."""
    jobs: int | None = setting(
        None,
        least=1,
        most=1024,
        short="-j",
        otherwise="as cores and memory allow",
        group="Advanced",
    )
    """Worker processes."""
    card: str = setting("auto", metavar="auto|none|PATH", group="Advanced")
    """Photograph of a calibration card; auto is the one in the folder whose name begins so."""

    @staticmethod
    def of(named: Mapping[str, Any]) -> BatchSettings:
        """Settings by name of a field, option or key of matcap.toml; others keep their defaults.

        Raises:
            UsageError: a value that the setting does not allow.
        """
        fields_by_name = {name: one.field for name, one in SETTINGS.items()}
        values = {fields_by_name.get(name, name): value for name, value in named.items()}

        def part(kind: type) -> dict[str, Any]:
            named = {f.name: values[f.name] for f in fields(kind) if f.name in values}
            return typed_settings(kind, named)

        return BatchSettings(
            CaptureSettings(**part(CaptureSettings)),
            OutputSettings(**part(OutputSettings)),
            **part(BatchSettings),
        )

    def named(self) -> dict[str, Any]:
        """All settings by the names of options: the inverse of of()."""
        values = asdict(self) | asdict(self.outputs) | self.capture.named()
        del values["outputs"], values["capture"]
        names = {one.field: name for name, one in SETTINGS.items()}
        return {names.get(name, name): value for name, value in values.items()}


@dataclass(frozen=True)
class Policy(CheckedSettings):
    """Which samples are captured again, and what counts as failure; of a run, not of a folder."""

    force: bool = setting(False, off=None, group="Advanced")
    """Capture again what is already captured."""
    retry_failed: bool = setting(False, off=None, group="Advanced")
    """Capture again what failed before."""
    fail_fast: bool = setting(False, off=None, group="Advanced")
    """End at the first failure."""
    overwrite: bool = setting(False, off=None)
    """Replace existing outputs."""
    strict: bool = setting(False, off=None, group="Output")
    """Count doubtful and failed verdicts as failures: exit code 3 or 4."""


# By name in options and matcap.toml.
SETTINGS: Mapping[str, Setting] = {
    one.name: one
    for kind in (OutputSettings, CaptureSettings, BatchSettings)
    for one in settings_in(kind).values()
}


def settings_of(source: Path, flags: Mapping[str, Any]) -> BatchSettings:
    """Settings of matcap.toml, where there is one, overridden by options.

    Args:
        source: the input folder; matcap.toml is in it, or else in its parent.
        flags: options by field, None where not given.

    Raises:
        UsageError: as read_settings.
    """
    places = (source / FILE, source.resolve().parent / FILE)
    file = next((file for file in places if file.is_file()), None)
    read = read_settings(file) if file else {}
    return BatchSettings.of(read | {name: v for name, v in flags.items() if v is not None})


def read_settings(file: Path) -> dict[str, Any]:
    """Read and check a matcap.toml: values by field. Its paths are relative to it.

    Raises:
        UsageError: not TOML; an unknown key, with the nearest known one; a value not allowed.
    """
    remedy = "correct it or remove it"
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise UsageError.at(file, "the file is too large for settings", remedy)
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UsageError.at(file, f"this is not TOML ({error})", remedy) from error
    except OSError as error:
        raise MatcapError.at(
            file, f"the settings cannot be read ({error.strerror})", remedy
        ) from error
    read = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name not in SETTINGS:
            raise UsageError.at(file, f"there is no setting {key[:60]!r}", nearest(name, SETTINGS))
        one = SETTINGS[name]
        read[one.field] = one.typed(value, f"{file}: {name}")
    plainly: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("prior", ("auto", "none")), ("card", ("auto", "none")), ("mask", ()),
    )  # fmt: skip
    for name, plain in plainly:
        if name in read and read[name] not in plain:
            read[name] = type(read[name])(file.parent / read[name])
    return read


# Hash of all inputs of a material: photographs, settings, version, prior, calibration.
#
# Equal hashes mean equal materials: one that exists need not be made again.

# Settings that do not change a material; of prior and card the content is hashed instead.
_NO_MATTER = ("jobs", "group", "gap", "card", "prior")


def identity(photos: Sequence[Path], settings: BatchSettings, *, prior: str, card: str = "") -> str:
    """SHA-256 of a material's inputs, 64 hexadecimal digits.

    Args:
        photos: in order; their content counts, their names do not.
        prior: prior_hash of the prior.
        card: hash of the calibration, or "".

    Raises:
        MatcapError: a photograph cannot be read.
    """
    chosen = {key: value for key, value in settings.named().items() if key not in _NO_MATTER}
    if settings.capture.mask is not None:
        chosen["mask"] = file_hash(settings.capture.mask)
    what: dict[str, Any] = {
        "photographs": [file_hash(photo) for photo in photos],
        "settings": chosen,
        "matcap": MAKER_VERSION,
        "prior": prior,
        "card": card,
    }
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def prior_hash(prior: str) -> str:
    """Hash of a prior named "auto", "none" or by a file.

    Raises:
        MatcapError: the file is no prior.
    """
    file = prior_file(prior)
    return prior if file is None else file_hash(file)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content.

    Raises:
        MatcapError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise MatcapError.at(
            path, f"the file cannot be read ({error.strerror})", "check its name and permissions"
        ) from error
