"""A capture from files to files: photographs are read, and material, maps and report written.

Does not import PyTorch: the stages in between (pipeline.py) do, while the photographs are read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.capture.bracket import find_brackets, fine_bracket, merge_bracket
from matcap.capture.settings import (
    BOTH_STAGES,
    DECODER_STAGES,
    DRAWING_STAGES,
    EXEMPLAR_STAGES,
    MULTIVIEW_STAGES,
    CaptureClock,
    CaptureProgress,
    CaptureSettings,
    OutputSettings,
    check_photographs,
    resolve,
)
from matcap.errors import MatcapError, UsageError
from matcap.files.threads import at_once
from matcap.photo.left_out import leave_out, shrunk
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo, ToneCurve

if TYPE_CHECKING:
    from matcap.capture.result import CaptureResult

OnCapture = Callable[[CaptureProgress], None]


def read_photograph(
    path: str | Path,
    settings: CaptureSettings,
    *,
    several: bool = False,
    tone: ToneCurve | None = None,
    fine: Photo | None = None,
) -> Photo:
    """Read a photograph for a capture: at its resolution, with crop and mask.

    Args:
        path: of the photograph.
        settings: of the capture.
        several: whether it is one of several photographs of a sample.
        tone: of a developed picture, if known.
        fine: the photograph, already read with all its pixels, if `tone` is known.

    Raises:
        UsageError: the preset is unknown; the crop exceeds the photograph; a crop or mask is given
            for several photographs.
        MatcapError: the file cannot be read as a photograph; the mask has another size; one of
            several photographs has transparent pixels.
    """
    detail = settings.most_detail
    if several:
        from matcap.capture.registration.keypoints import LONG_SIDE

        detail = max(settings.detail or 0, LONG_SIDE)
    if several and (settings.crop or settings.mask):
        raise UsageError.at(
            "--crop" if settings.crop else "--mask",
            "one rectangle or mask cannot fit several photographs, each taken from another place",
            "leave it out: what does not belong to the sample is detected",
        )
    if fine is not None:
        photo = shrunk(fine, detail, tone or ToneCurve())
    else:
        fov, white = settings.fov, settings.white
        photo = load_photo(path, long_side=detail, fov=fov, white=white, tone=tone)
    if several and photo.left_out is not None:
        raise MatcapError.at(
            path,
            "a part of the picture is transparent, which is not supported with --together",
            "give the original photograph: what is not the sample is detected",
        )
    return leave_out(photo, settings.crop, settings.mask)


def capture_into(
    folder: Path,
    paths: Sequence[str | Path],
    settings: CaptureSettings,
    outputs: OutputSettings,
    progress: OnCapture | None = None,
    spent: float = 0.0,
) -> CaptureResult:
    """Capture photographs of one sample and write the material, maps, preview and report.

    Args:
        folder: created if missing; its name becomes the material's.
        paths: one photograph, or several of the same sample.
        settings: of the capture.
        outputs: what to write.
        progress: callback.
        spent: seconds of the time limit that the command's start has taken.

    Raises:
        UsageError, MatcapError: as capture_photo; the disk is full; the folder cannot be written.
    """
    check_photographs(settings, len(paths))  # before anything is read
    groups = find_brackets([Path(path) for path in paths], fov=settings.fov)
    clock = clock_of(settings, progress, len(groups), spent)
    result = _captured(groups, settings, clock)
    from matcap.capture.report import write_outputs

    with clock.completed("write"):
        write_outputs(result, folder, outputs)
    return replace(result, status=clock.status)


def capture_file(
    path: str | Path,
    settings: CaptureSettings,
    progress: OnCapture | None = None,
    others: Sequence[str | Path] = (),
    clock: CaptureClock | None = None,
) -> CaptureResult:
    """Capture the file of a photograph, with `others` of the same sample.

    Exposures from one place are merged into one photograph (bracket.py). Arguments and exceptions
    are those of read_photograph and capture_photo. The result's photograph has the notes on all of
    them.
    """
    paths = [Path(path), *map(Path, others)]
    check_photographs(settings, len(paths))  # before anything is read
    groups = find_brackets(paths, fov=settings.fov)
    return _captured(groups, settings, clock or clock_of(settings, progress, len(groups)))


def read_exposures(paths: Sequence[Path], settings: CaptureSettings, *, several: bool) -> Photo:
    """Read a photograph, or the exposures of a bracket merged into one.

    Crop and mask are of the first, and left out of what is merged: what they leave out is mirrored,
    and would be compared with the others. Arguments and exceptions as of read_photograph.
    """
    if len(paths) == 1:
        return read_photograph(paths[0], settings, several=several)
    whole = settings if several else replace(settings, crop=None, mask=None)
    read = partial(read_photograph, settings=whole, several=several)
    fine = fine_bracket(paths, settings.most_detail, fov=settings.fov, white=settings.white)
    if fine is None:
        merged = merge_bracket([read(path) for path in paths])
    else:
        each = zip(paths, fine.curves, fine.views, strict=True)
        photos = [read(path, tone=tone, fine=view.whole) for path, tone, view in each]
        merged = fine.of(photos).merged()
    return leave_out(merged, settings.crop, settings.mask)


def _captured(
    groups: Sequence[Sequence[Path]], settings: CaptureSettings, clock: CaptureClock
) -> CaptureResult:
    """Capture photographs of one sample, each of one or several exposures."""
    several = len(groups) > 1

    def read() -> list[Photo]:
        return list(
            at_once(*(partial(read_exposures, g, settings, several=several) for g in groups))
        )

    with clock.stage("read"):
        # Importing PyTorch takes longer than reading a photograph.
        photos, pipeline = at_once(read, partial(import_module, f"{__package__}.pipeline"))
        notes = (f"{other.name}: {note}" for other in photos[1:] for note in other.notes)
        photos[0] = replace(photos[0], notes=(*photos[0].notes, *notes))
    # Popped: its pixels are not needed once its tone curve is undone.
    captured: CaptureResult = pipeline.capture_photo(
        photos.pop(0), settings, others=photos, clock=clock
    )
    return captured


def clock_of(
    settings: CaptureSettings, progress: OnCapture | None, photographs: int = 1, spent: float = 0.0
) -> CaptureClock:
    """Clock of a capture of a number of photographs; its last stage, `write`, is the caller's."""
    by_example = MULTIVIEW_STAGES if photographs > 1 else EXEMPLAR_STAGES
    by_decoder = DRAWING_STAGES if settings.draws else DECODER_STAGES
    if photographs == 1 and settings.generator is None and resolve(settings).steps:
        by_example = BOTH_STAGES
    stages = by_decoder if settings.generator == "decoder" else by_example
    return CaptureClock(progress, stages, settings.time_limit, spent)
