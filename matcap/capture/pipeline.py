"""The whole way from a photograph to a material. This file reads as its data flow.

read, coarse fit, piece, strengths, refine, adapt, inpaint, index, verdict, write.
The stages from piece to index are in piece/find.py. The paper's network goes another way
(by_decoder.py), where it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from matcap.capture.detail import Rectified
from matcap.capture.ending import judged, provenance
from matcap.capture.method import Method
from matcap.capture.outputs import write_outputs
from matcap.capture.piece.find import Adaptation, PhotographEstimate, find_piece
from matcap.capture.piece.network.store import load_inverse
from matcap.capture.progress import (
    DECODER_STAGES,
    PIECE_STAGES,
    TOGETHER_STAGES,
    CaptureClock,
    CaptureProgress,
)
from matcap.capture.result import CaptureResult
from matcap.capture.settings import (
    DETAIL,
    CaptureSettings,
    Effort,
    OutputSettings,
    check_photographs,
    resolve,
)
from matcap.capture.target import CaptureStart, photograph_target
from matcap.capture.tilt import fitted
from matcap.capture.upright import upright
from matcap.errors import MatcapError, UsageError
from matcap.field.material import Material
from matcap.files.interrupts import postponed
from matcap.flash.plane import Plane
from matcap.photo.camera import read_camera_profile
from matcap.photo.left_out import leave_out
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo
from matcap.photo.refusals import SHORTEST_SIDE

_MATCHED = 1600  # pixels along the long side that photographs of one piece are matched on
_WINDOW_STEP = 16  # texels that windows' sides are multiples of: a decoder's alignment

OnCapture = Callable[[CaptureProgress], None]


def read_photograph(
    path: str | Path,
    settings: CaptureSettings,
    method: Method | None = None,
    *,
    several: bool = False,
) -> Photo:
    """A photograph as a capture with these settings, done so, needs it; of several, or alone.

    Raises:
        UsageError: an unknown preset; a crop outside of the photograph, or of several; a bad
            profile of the camera.
        MatcapError: the file is not a photograph that can be read; a mask that does not fit; one
            of several that is cut out.
    """
    # What is compared with the photograph must know its noise.
    noise = resolve(settings, method).work(settings.generator) > 0
    detail = max(settings.detail or 0, _MATCHED) if several else settings.most_detail
    if several and (settings.crop or settings.mask):
        raise UsageError(
            "one rectangle or mask cannot fit several photographs, each taken from another place",
            where="--crop" if settings.crop else "--mask",
            remedy="leave it out: what does not belong to the piece is detected",
        )
    photo = load_photo(path, long_side=detail, fov=settings.fov, noise=noise)
    if settings.camera is not None:
        photo = photo.known_by(read_camera_profile(settings.camera))
    if several and photo.left_out is not None:
        raise MatcapError(
            "a part of the picture is transparent, which is not supported with --together",
            where=str(path),
            remedy="give the photograph as it was taken: what does not belong is detected",
        )
    return leave_out(photo, settings.crop, settings.mask)


def capture_file(
    path: str | Path,
    settings: CaptureSettings,
    progress: OnCapture | None = None,
    others: Sequence[str | Path] = (),
) -> CaptureResult:
    """A photograph's file to a material; or those of several photographs of one sample.

    Args, Raises: as of read_photograph and capture_photo.
    """
    return _read_and_captured(
        [path, *others], settings, clock_of(settings, progress, 1 + len(others))
    )


def capture_into(
    folder: Path,
    paths: Sequence[str | Path],
    settings: CaptureSettings,
    outputs: OutputSettings,
    progress: OnCapture | None = None,
    spent: float = 0.0,
) -> CaptureResult:
    """The whole way: photographs of one sample to a folder with everything that is left of it.

    Args:
        folder: to be made; the material is called as it is.
        paths: of the photograph, and of more of the same sample.
        settings: what the user decides.
        outputs: what is written.
        progress: called as the work goes on.
        spent: seconds of the time limit that are gone already: starting takes some, too.

    Raises:
        UsageError, MatcapError: as capture_photo; a full disk, an unwritable folder.
    """
    clock = clock_of(settings, progress, len(paths), spent)
    result = _read_and_captured(paths, settings, clock)
    with clock.stage("write"), postponed() as stopped:
        write_outputs(result, folder, outputs)
    return replace(result, interrupted=result.interrupted or stopped())


def _read_and_captured(
    paths: Sequence[str | Path], settings: CaptureSettings, clock: CaptureClock
) -> CaptureResult:
    check_photographs(settings, len(paths))  # before anything is read
    with clock.stage("read"):
        several = len(paths) > 1
        photo, *more = (read_photograph(path, settings, several=several) for path in paths)
        said = (f"{other.name}: {note}" for other in more for note in other.notes)
        photo = replace(photo, notes=(*photo.notes, *said))
    return capture_under(photo, settings, clock, Method(), more)


def capture_photo(
    photo: Photo,
    settings: CaptureSettings,
    progress: OnCapture | None = None,
    method: Method | None = None,
    others: Sequence[Photo] = (),
) -> CaptureResult:
    """A photograph to a material.

    Args:
        photo: as read_photograph gives it.
        settings: what the user decides.
        progress: called as the work goes on.
        method: how to do it; the best known way by default.
        others: more photographs of the same sample (flash/joint.py); the result shows the first.

    Raises:
        UsageError: an unknown preset, or a union of one photograph.
        MatcapError: a photograph nothing can be made of, or a prior that cannot be read.
    """
    return capture_under(
        photo, settings, clock_of(settings, progress, 1 + len(others)), method or Method(), others
    )


def clock_of(
    settings: CaptureSettings,
    progress: OnCapture | None,
    photographs: int = 1,
    spent: float = 0.0,
) -> CaptureClock:
    """The clock of a capture of so many photographs; `write` is the caller's last stage."""
    by_example = TOGETHER_STAGES if photographs > 1 else PIECE_STAGES
    stages = DECODER_STAGES if settings.generator == "decoder" else by_example
    return CaptureClock(progress, stages, settings.time_limit, spent)


def capture_under(
    photo: Photo,
    settings: CaptureSettings,
    clock: CaptureClock,
    method: Method,
    others: Sequence[Photo],
) -> CaptureResult:
    """The stages between reading and writing; see capture_photo."""
    check_photographs(settings, 1 + len(others))
    effort = resolve(settings, method, 1 + len(others))
    if settings.generator == "decoder":
        from matcap.capture.by_decoder import capture_by_decoder

        shot = _begun(photo, settings, method, clock, others)
        shot = replace(shot, rectified=shot.rectified.as_read())
        return upright(capture_by_decoder(shot, settings, effort, method, clock), ())
    if others:
        captured = _of_several([photo, *others], settings, effort, method, clock)
    else:
        captured = _of_one(photo, settings, effort, method, clock)
    estimate, coarse, rectified = captured.estimate, captured.coarse, captured.rectified
    several = [] if estimate.several is None else estimate.several.document()["photographs"][1:]
    material = Material(
        name=photo.stem,
        generators={"example": estimate.example},
        texel_size=rectified.whole.texel_size,
        setup=coarse.setup.dimmed(estimate.scale),
        provenance=provenance(captured.photo, settings, coarse, effort, several),
    )
    result = judged(captured.photo, material, rectified, settings, clock, estimate)
    return upright(result, rectified.waves)


def _begun(
    photo: Photo,
    settings: CaptureSettings,
    method: Method,
    clock: CaptureClock,
    others: Sequence[Photo] = (),
) -> CaptureStart:
    """A photograph without its tone curve, under its light, on its plane."""
    with clock.stage("coarse fit"):
        coarse = fitted(photo, measured=method.measured_tilt)
        photo = photo.linearised(coarse.tone)
        detail = settings.detail_of(max(photo.pixels.shape))
        rectified = Rectified.of_photo(photo, coarse, detail)
        window = _window(rectified.read, method.window, photo.name)
    return CaptureStart(photo, coarse, rectified, window, others)


def _of_one(
    photo: Photo, settings: CaptureSettings, effort: Effort, method: Method, clock: CaptureClock
) -> PhotographEstimate:
    """The exemplar of one photograph."""
    shot = _begun(photo, settings, method, clock)
    adaptation = None
    if effort.adapted:
        adaptation = Adaptation(
            lambda: photograph_target(shot, settings, method)[0], effort.adapted, settings.seed
        )
    absolute = photo.flash_intensity is not None
    estimate = find_piece(
        shot.rectified, shot.coarse, load_inverse(), clock, adaptation, absolute=absolute
    )
    return PhotographEstimate(estimate, shot.coarse, shot.rectified, shot.photo)


def _of_several(
    photos: Sequence[Photo],
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
    clock: CaptureClock,
) -> PhotographEstimate:
    """The exemplar of several photographs of one sample."""
    from matcap.capture.together.find import estimate_together

    # As fine as they are solved at best, but where preset or time ask for less.
    detail = settings.detail or min(effort.detail, DETAIL)
    solving, union = method.solving, settings.union
    return estimate_together(photos, load_inverse(), detail, solving, clock, union=union)


def _window(plane: Plane, wanted: int, name: str) -> int:
    """Window size that fits the picture."""
    width, height = plane.size
    if min(height, width) < SHORTEST_SIDE:
        raise MatcapError(
            f"at this detail the picture is {width} x {height} texels, too few to hold a texture",
            where=name,
            remedy=f"raise --detail, or crop it, until both are at least {SHORTEST_SIDE}",
        )
    return min(wanted, *(side // _WINDOW_STEP * _WINDOW_STEP for side in (height, width)))
