"""report.json: what was done, with what, how well, and what the user should know.

Keys:
    format: "matcap report".
    name: of the material.
    interrupted: whether it was ended early.
    verdict: `rating` (good, usable, doubtful or failed), `fit` (good or usable), `severity` (up to
        1 is good, 2 usable, 3 doubtful), `sentence` (the largest difference, its cause and remedy),
        `causes` that the photograph shows, each with its remedy, and all `checks`
        (photo/checks.py): each `value` and `unit`, rating or "not judged", severity, `says`,
        cause and remedy.
    highlight: of the photograph and of its re-rendering under the same flash, both clipped where
        the photograph is, in pairs; or null where the mirror point is not in the picture. `rings`
        about it, out to `radii` (plane units) and beyond the last: mean radiance over an even matte
        surface's, 1 beyond the last; the first is the highlight contrast. `contrast_ratio`,
        re-rendered over photographed (null where neither is glossy; of a clipped core also of the
        innermost ring that is not, whichever is farther from 1); `clipped`, share of each ring:
        beyond 5 % of the first the photographed contrast is a lower bound. `glints`, standard
        deviation of log radiance by octave, finest first, and `glint_ratio`.
    error: `piece`, median difference of log radiance between the photograph and the re-rendered
        piece; `field`, difference of texture between the photograph and the endless material in
        multiples of what the photograph's own parts differ by; null where there is none.
    warnings: what may have hurt, a sentence each.
    notes: what was noticed about the file, a sentence each.
    photograph: name, sizes, RAW (`radiometric`) or not, flash, gain map, clipped share.
    camera: `fov_degrees` and where it is from, distance, `tilt_degrees`, `tilt_sources` (degrees
        about x and y: `used`, `branch`, which is the alignment branch's with its standard deviation
        `branch_std`, and `picture`, which is the coarse fit's without it; null of several
        photographs, whose registration gives it), flash offset and intensity, vignetting with r^2
        and r^4, the `tone_curve` that was undone (photo/tone.py) or null, and the `profile` of the
        camera that they were fitted under, or null: its camera, over how many photographs,
        `falloff` (r^2 and r^4), `deviation` and `correlation`.
    texel_size: plane units.
    settings: that were asked for.
    effort: what they came to: preset, steps of adaptation (`adapted`) and of a decoder (`steps`),
        windows a step, matched or not.
    seconds: that the work took.
    stage_seconds: that each stage took.
    tuning: of a decoder, or null: `error` (the last one), `self_difference` (what the photograph's
        own windows differ by, in the same measure), `relative_error` (the one in multiples of the
        other), `error_after_another_minute` (to be expected of the same work) and
        `error_over_time` (seconds, step and error).
    exemplar: of the maps of the photographed piece, or null: `error` (median difference of log
        radiance between photograph and re-rendering), `slow` (its slow part, not the
        material's), `left_out` (share that matches nothing else in it, and is not rearranged),
        `variety` (how far its field takes it apart, from 0 to 1), `patches` (their size, in words),
        `strengths` (root-mean-square slope and log albedo measured by the photograph, by
        band; see capture/piece/strengths.py; or null), `sharpness` (power of the finest octave,
        re-rendering over photograph), `adaptation` (of each leg: what it changed, how near it was
        before and after on windows held back, and whether it was kept), `confidence` (mean, by
        map), `specular_channels` (3 where F0 has a colour), `highlight_residue` (radial variation
        about the flash's mirror point: of the logarithms of `albedo`, `specular` and `grain`,
        relief's strength, and of `roughness`).
    several: of several photographs of one piece, or null: `photographs` (name, `flash`, false of
        one by the room's light, `matches` with the first, `likeness`, `place` in plane units, tilt,
        `doubt`, what that place may be off by over its distance, one deviation, `residual` of its
        re-rendering, and `predicted`, the same where all others alone decided, or null),
        `left_out` (name and why), `measured_share` (by map: measured by photographs rather than the
        network), flash offset and lens distortion;
        of a union `union`: `margins` (texels around the first photograph's own), `times` (its
        texels over those), `covered_share` (of what photographs show, in it), `seen_share` (of it,
        by any photograph) and `limited` (it would be larger but for memory).
    provenance: how the material was made.
    versions: of matcap, Python, the system and the libraries.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.example.summary import summary
from matcap.files.maker import MAKER_VERSION
from matcap.files.staging import staged
from matcap.photo.checks import Rating

if TYPE_CHECKING:
    from matcap.capture.piece.find import ExemplarEstimate
    from matcap.capture.result import CaptureResult, Tuning
    from matcap.capture.settings import CaptureSettings
    from matcap.capture.together.set_report import SetReport

CURVE = "error.png"
_LIBRARIES = ("torch", "numpy", "opencv-contrib-python-headless", "rawpy", "OpenEXR")


def write_report(result: CaptureResult, path: Path) -> None:
    """Write the report of a capture, and beside it error.png of a decoder, its error over time.

    Raises:
        MatcapError: the file cannot be written.
    """
    text = json.dumps(_finite(report(result)), indent=2, default=str, allow_nan=False)
    with staged(path.parent) as stage:
        (stage / path.name).write_text(text + "\n")
        if result.tuning is not None:
            from matcap.space.tuning.curve import draw_history

            tuning = result.tuning
            draw_history(tuning.history, tuning.self_difference).save(stage / CURVE)


def report(result: CaptureResult) -> dict[str, Any]:
    """The report as plain data. Angles in degrees, times in seconds, lengths in plane units."""
    setup, photo = result.material.setup, result.photo
    profile = result.measurements.profile
    return {
        "format": "matcap report",
        "name": result.material.name,
        "interrupted": result.interrupted,
        "verdict": result.verdict.document(),
        "highlight": None if profile is None else profile.document(),
        "error": result.errors,
        "warnings": list(warnings(result)),
        "notes": [
            *photo.notes,
            *_grown(result.estimate),
            *_rules(result),
        ],
        "photograph": {
            "name": photo.name,
            "path": None if photo.path is None else str(photo.path),
            "size": list(photo.original_size),
            "size_used": [photo.pixels.shape[1], photo.pixels.shape[0]],
            "turned": photo.turned,
            "radiometric": photo.radiometric,
            "flash_fired": photo.flash_fired,
            "gain_map_applied": photo.gain_map_applied,
            "clipped_share": photo.clipped_share,
        },
        "camera": {
            "fov_degrees": setup.fov,
            "fov_source": photo.fov_source,
            "distance": setup.distance,
            "tilt_degrees": [math.degrees(angle) for angle in setup.tilt],
            "tilt_sources": result.tilt_sources,
            "flash_offset": list(setup.offset),
            "flash_intensity": list(setup.intensity),
            "vignetting": setup.vignetting,
            "vignetting_quartic": setup.vignetting_quartic,
            "tone_curve": photo.tone and asdict(photo.tone),
            "profile": photo.profile and photo.profile.document(),
        },
        "texel_size": result.material.texel_size,
        "settings": result.settings.named(),
        "effort": asdict(result.effort),
        "seconds": sum(result.stage_seconds.values()),
        "stage_seconds": dict(result.stage_seconds),
        "tuning": _tuning(result.tuning),
        "exemplar": _exemplar(result),
        "several": _several(result.estimate),
        "provenance": result.material.provenance,
        "versions": {
            "matcap": MAKER_VERSION,
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in _LIBRARIES},
        },
    }


def _several(estimate: ExemplarEstimate | None) -> dict[str, Any] | None:
    return None if estimate is None or estimate.several is None else estimate.several.document()


def _tuning(tuning: Tuning | None) -> dict[str, Any] | None:
    if tuning is None:
        return None
    from matcap.space.tuning.anytime import forecast

    history = tuning.history
    return {
        "error": history[-1][2] if history else None,
        "self_difference": tuning.self_difference,
        "relative_error": tuning.relative_error,
        "error_after_another_minute": forecast(history, 60.0),
        "error_over_time": [
            {"seconds": seconds, "step": step, "error": error} for seconds, step, error in history
        ],
    }


def _exemplar(result: CaptureResult) -> dict[str, Any] | None:
    estimate = result.estimate
    if estimate is None:
        return None
    return {
        "error": estimate.error,
        "slow": estimate.slow,
        "left_out": estimate.example.index.left_out,
        "variety": estimate.example.variety,
        "patches": summary(estimate.example).patches_text(),
        "strengths": None if estimate.strengths is None else estimate.strengths.document(),
        "sharpness": estimate.sharpness,
        "adaptation": [asdict(change) for change in estimate.adaptation],
        "confidence": estimate.mean_confidence(result.photo.kept_share),
        "specular_channels": len(estimate.exemplar.specular),
        "highlight_residue": result.measurements.residue,
    }


def warnings(result: CaptureResult) -> Iterable[str]:
    """What may have hurt the result, each with what to do at the next shot."""
    if result.interrupted:
        yield "Interrupted: this is the best so far; run it again for a better result."
    # What the light shows of a flash is the verdict's; what the file says of it is worth a warning.
    keys = (
        ("flash", "clipped", "tilt") if result.photo.flash_fired is False else ("clipped", "tilt")
    )
    shot = (result.measurements.photograph[key] for key in keys)
    yield from (finding.line() for finding in shot if finding.rating is not Rating.GOOD)
    if result.estimate is not None and result.estimate.several is not None:
        for one in result.estimate.several.left_out:
            yield f"{one.name} was left out: {one.why}."
        doubted = result.estimate.several.doubted()
        if doubted:
            yield doubted
        yield from _union(result.estimate.several, result.settings)
    if result.estimate is not None and result.estimate.strengths is None:
        yield (
            "The photograph is too small, or too much of it clipped or masked, to measure the "
            "strength of its relief: it is the network's estimate. Photograph again a stop darker, "
            "or from further away."
        )


def _union(several: SetReport, settings: CaptureSettings) -> Iterable[str]:
    """What became of a union that was asked for, where it is not all."""
    if several.reach is None and settings.union:
        yield (
            "The other photographs show hardly more than the first one, so --union makes the maps "
            "no larger. Move the phone farther from one to the next, by up to half a picture."
        )
    limited = several.reach and several.reach.warns()
    if limited:
        yield limited


def _grown(estimate: ExemplarEstimate | None) -> Iterable[str]:
    """How large a piece is that reaches beyond the first photograph."""
    if estimate is not None and estimate.several is not None and estimate.several.reach is not None:
        yield estimate.several.reach.says()


def _rules(result: CaptureResult) -> Iterable[str]:
    """What follows from the settings and is not what it was called."""
    settings, effort = result.settings, result.effort
    if settings.solves(result.photographs):
        if settings.time_limit is not None:
            yield (
                "Several photographs are solved in one pass, without steps that --time could "
                "limit: it decides their detail instead."
            )
    elif effort.preset != settings.preset:
        yield (
            "A time limit or a target decided when to stop, so the preset was "
            f"{effort.preset}: at most {effort.work(settings.generator)} steps. "
            "Give --steps for another number."
        )
    if settings.width_cm is None:
        yield (
            "The size of the sample is unknown: heights are in units of half the photograph's long "
            "side. Give --width-cm, the width that the photograph shows."
        )


def _finite(value: object) -> object:
    """The same data with null for numbers that JSON does not know."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value
