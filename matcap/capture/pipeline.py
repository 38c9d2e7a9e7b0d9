"""Capture, from photographs to a folder with a material: the stages in order.

read, coarse fit, network, relief spectrum, refine, inpaint, index, verdict, write.
The stages from network to index are in exemplar/estimate.py, those of several photographs in
multiview/estimate.py, those of the paper's generator in by_decoder.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from matcap.capture.bracket import find_brackets, fine_bracket, merge_bracket
from matcap.capture.exemplar.estimate import ExemplarEstimate, KnownMeans, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.rectified import Method, Rectified, fit_photograph
from matcap.capture.registration.keypoints import LONG_SIDE
from matcap.capture.registration.register import register_in_any_order
from matcap.capture.report import write_outputs
from matcap.capture.result import CaptureResult, judge_material, provenance
from matcap.capture.settings import (
    BOTH_STAGES,
    DECODER_STAGES,
    DETAIL,
    DRAWING_STAGES,
    EXEMPLAR_STAGES,
    MULTIVIEW_STAGES,
    CaptureClock,
    CaptureProgress,
    CaptureSettings,
    OutputSettings,
    RunStatus,
    check_photographs,
    resolve,
)
from matcap.errors import MatcapError, UsageError
from matcap.field.material import Latent, Material
from matcap.flash.highlight import limit_sparkles
from matcap.photo.left_out import leave_out, shrunk
from matcap.photo.load import load_photo
from matcap.photo.photo import SHORTEST_SIDE, Photo, ToneCurve

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
    detail = max(settings.detail or 0, LONG_SIDE) if several else settings.most_detail
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
    with clock.stage("read"):
        several = len(groups) > 1
        photo, *more = (read_exposures(group, settings, several=several) for group in groups)
        notes = (f"{other.name}: {note}" for other in more for note in other.notes)
        photo = replace(photo, notes=(*photo.notes, *notes))
    return capture_photo(photo, settings, others=more, clock=clock)


def capture_photo(
    photo: Photo,
    settings: CaptureSettings,
    progress: OnCapture | None = None,
    method: Method | None = None,
    others: Sequence[Photo] = (),
    clock: CaptureClock | None = None,
) -> CaptureResult:
    """Capture a material from a photograph, or from several of the same sample.

    Args:
        photo: returned by read_photograph.
        settings: of the capture.
        progress: callback.
        method: variant of the method; the default one if None.
        others: more photographs of the same sample; the result shows the first, `photo`, or a
            better one (register_in_any_order), and is that one's if no other can be registered.
        clock: of a capture that has begun, whose callback takes the place of `progress`; or None.

    Raises:
        UsageError: the preset is unknown, or `union` is set for one photograph.
        MatcapError: the photograph is too small or has no valid pixels, or the prior is unreadable.
    """
    method, clock = method or Method(), clock or clock_of(settings, progress, 1 + len(others))
    check_photographs(settings, 1 + len(others))
    effort = replace(resolve(settings), steps=0) if others else resolve(settings)
    if settings.generator == "decoder":
        from matcap.capture.by_decoder import capture_by_decoder

        rectified = _rectified(photo, settings, method, clock).at_input_resolution()
        result = capture_by_decoder(rectified, settings, method, clock)
        latent = _latent(rectified, settings)
        return replace(result, material=replace(result.material, latent=latent))
    rectified, estimate = _estimated([photo, *others], settings, method, clock)
    # The first given has the notes of all, whichever defines the frame.
    given = {note for one in (photo, *others) for note in one.notes}
    notes = *photo.notes, *(note for note in rectified.photo.notes if note not in given)
    rectified = replace(rectified, photo=replace(rectified.photo, notes=notes))
    several = [] if estimate.several is None else estimate.several.document()["photographs"][1:]
    material = Material(
        name=photo.stem,
        generators={"example": estimate.example},
        texel_size=rectified.whole.texel_size,
        setup=replace(rectified.coarse.setup.dimmed(estimate.scale), turned=estimate.turned),
        provenance=provenance(rectified, settings, effort, several),
        latent=_latent(rectified, settings),
    )
    result = judge_material(rectified, material, settings, clock, estimate)
    if not effort.steps or result.status is RunStatus.INTERRUPTED:
        return result
    from matcap.capture.by_decoder import with_decoder

    return with_decoder(result, rectified, effort, clock)


def _estimated(
    photos: Sequence[Photo], settings: CaptureSettings, method: Method, clock: CaptureClock
) -> tuple[Rectified, ExemplarEstimate]:
    """The exemplar of one photograph or several, and the photograph in whose frame it is.

    Of several of which only one is left, the estimate is that one's, with a report on the others.
    """
    (photo, *others), registration = photos, None
    if others:
        with clock.stage("register"):
            registration = register_in_any_order(photos)
        if len(registration.views) > 1:
            from matcap.capture.multiview.estimate import estimate_multiview

            # The multi-view solve is limited to DETAIL; preset and time limit may ask for less.
            detail = settings.detail or min(resolve(settings).detail, DETAIL)
            return estimate_multiview(
                registration, load_inverse(), detail, clock, union=settings.union
            )
        photo = registration.views[0].photo
    rectified = _rectified(photo, settings, method, clock)
    absolute = photo.flash_intensity is not None
    known = KnownMeans(settings.albedo, settings.roughness, absolute=absolute)
    estimate = estimate_exemplar(rectified, load_inverse(), clock, known, turned=photo.turned)
    if registration is not None:
        from matcap.capture.multiview.set_report import SetReport

        of_one = rectified.coarse.setup, rectified.whole.size, estimate.error
        estimate = replace(estimate, several=SetReport.alone(registration, *of_one))
    return rectified, estimate


def _latent(rectified: Rectified, settings: CaptureSettings) -> Latent:
    """Position in the prior's space of the photograph, of several that of the frame's."""
    from matcap.space.prior.store import load_prior

    named = settings.prior not in ("auto", "none")
    prior, photo = load_prior(Path(settings.prior) if named else None), rectified.photo
    pixels = photo.developed(photo.pixels)  # as the encoder was trained on
    return prior.kept(
        prior.anchor(pixels, rectified.coarse, rectified.network_input, rectified.input_waves)
    )


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


def _rectified(
    photo: Photo, settings: CaptureSettings, method: Method, clock: CaptureClock
) -> Rectified:
    """Fit camera and flash, undo the tone curve and rectify the photograph to its plane.

    Raises:
        MatcapError: the plane is shorter than SHORTEST_SIDE texels.
    """
    with clock.stage("coarse fit"):
        photo = limit_sparkles(photo)
        coarse = fit_photograph(photo, measured=method.measured_tilt, metal=settings.metal)
        photo = photo.linearised(coarse.tone)
        rectified = Rectified.of(photo, coarse, settings.detail_of(max(photo.pixels.shape)))
        width, height = rectified.network_input.size
        if min(height, width) < SHORTEST_SIDE:
            raise MatcapError.at(
                photo.name,
                f"at this detail the picture is {width} x {height} texels, "
                "too few to hold a texture",
                f"raise --detail, or crop it, until both are at least {SHORTEST_SIDE}",
            )
    return rectified
