"""Capture, from photographs to a material with its verdict: the stages in order.

coarse fit, network, relief spectrum, refine, inpaint, index, verdict. Before them, photographs are
read, and after them the results are written (run.py). The stages from network to index are in
exemplar/estimate.py, those of several photographs in multiview/estimate.py, those of the paper's
generator in by_decoder.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from matcap.capture.exemplar.estimate import ExemplarEstimate, KnownMeans, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.rectified import Method, Rectified, fit_photograph
from matcap.capture.registration.register import register_in_any_order
from matcap.capture.result import CaptureResult, judge_material, provenance
from matcap.capture.run import OnCapture, clock_of
from matcap.capture.settings import (
    DETAIL,
    CaptureClock,
    CaptureSettings,
    RunStatus,
    check_photographs,
    resolve,
)
from matcap.errors import MatcapError
from matcap.field.material import Latent, Material
from matcap.files.threads import at_once, one_thread
from matcap.flash.highlight import limit_sparkles
from matcap.photo.photo import SHORTEST_SIDE, Photo


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
    photos, stem, notes = [photo, *others], photo.stem, photo.notes
    # The first given has the notes of all, whichever defines the frame.
    given = {note for one in photos for note in one.notes}
    del photo, others
    rectified, estimate = _estimated(photos, settings, method, clock)
    notes = *notes, *(note for note in rectified.photo.notes if note not in given)
    rectified = replace(rectified, photo=replace(rectified.photo, notes=notes))
    several = [] if estimate.several is None else estimate.several.document()["photographs"][1:]
    material = Material(
        name=stem,
        generators={"example": estimate.example},
        texel_size=rectified.whole.texel_size,
        setup=replace(rectified.coarse.setup.dimmed(estimate.scale), turned=estimate.turned),
        provenance=provenance(rectified, settings, effort, several),
    )
    result, latent = at_once(
        partial(judge_material, rectified, material, settings, clock, estimate),
        partial(_latent, rectified, settings),
    )
    result = replace(result, material=replace(result.material, latent=latent))
    if not effort.steps or result.status is RunStatus.INTERRUPTED:
        return result
    from matcap.capture.by_decoder import with_decoder

    return with_decoder(result, rectified, effort, clock)


def _estimated(
    photos: list[Photo], settings: CaptureSettings, method: Method, clock: CaptureClock
) -> tuple[Rectified, ExemplarEstimate]:
    """The exemplar of one photograph or several, and the photograph in whose frame it is.

    Of several of which only one is left, the estimate is that one's, with a report on the others.
    One is popped, as its pixels are not needed once its tone curve is undone.
    """
    registration = None
    if len(photos) > 1:
        with clock.stage("register"):
            registration = register_in_any_order(photos)
        if len(registration.views) > 1:
            from matcap.capture.multiview.estimate import estimate_multiview

            # The multi-view solve is limited to DETAIL; preset and time limit may ask for less.
            detail = settings.detail or min(resolve(settings).detail, DETAIL)
            return estimate_multiview(
                registration, load_inverse(), detail, clock, union=settings.union
            )
        photos = [registration.views[0].photo]
    rectified = _rectified(photos.pop(), settings, method, clock)
    photo = rectified.photo
    absolute = photo.flash_intensity is not None
    known = KnownMeans(settings.albedo, settings.roughness, absolute=absolute)
    with one_thread():
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


def _rectified(
    photo: Photo, settings: CaptureSettings, method: Method, clock: CaptureClock
) -> Rectified:
    """Fit camera and flash, undo the tone curve and rectify the photograph to its plane.

    Raises:
        MatcapError: the plane is shorter than SHORTEST_SIDE texels.
    """
    with clock.stage("coarse fit"), one_thread():
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
