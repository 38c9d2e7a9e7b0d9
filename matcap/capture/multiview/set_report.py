"""Report on several photographs: cameras, residuals, leave-one-out errors, and their diagram."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from matcap.brdf.maps import CHANNELS, MapSet
from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.multiview.solve import Solved, solve
from matcap.capture.multiview.texels import (
    Estimate,
    SharedMaterials,
    as_photographed,
    parameters_of,
)
from matcap.capture.multiview.views import ResampledView, SharedLight
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.keypoints import SHADOW
from matcap.capture.registration.register import SHADED, LeftOut, RegisteredView, Registration
from matcap.files.color import srgb_picture
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import picture_of
from matcap.photo.checks import CHECKS
from matcap.photo.photo import standing

# Leave-one-out error of a set: each photograph predicted from all the others.
#
# This needs no ground truth, as maps of the others are not fitted to the photograph left out.

# Settings of the leave-one-out solves; docs/notes/several.md.
_ACROSS = 224  # texels across the grid, enough for errors of shading and gloss
# Steps per texel in each round (solve.ROUNDS) of the solutions without one photograph, which start
# from that of all.
_WITHOUT = (1,)
# Texels to which shared parameters are fitted; few, as the initial light is nearly exact.
_SAMPLED = 1500
# Share of the error by the first photograph alone above which the set's maps are not kept: those of
# glazed tiles, at 0.8 and 0.94, were 1.6 and 1.3 times as far from the truth as the first one's.
_CLEARLY = 0.75


class Prediction(NamedTuple):
    """A photograph and its rendering by maps of others, linear, (H, W, 3); 0 where not seen."""

    number: int
    """Of the photograph, from 1."""
    photographed: NDArray[np.float32]
    rendered: NDArray[np.float32]

    @staticmethod
    def of(number: int, view: ResampledView, rendered: Tensor) -> Prediction:
        """From log radiance (3, H, W)."""
        both = (picture_of(view.seen * log.exp()) for log in (view.log, rendered))
        return Prediction(number, *both)


class LeaveOneOut(NamedTuple):
    """Medians of |log radiance of photograph - rendering| for each photograph, on a coarse grid.

    NaN without flash.
    """

    by_others: tuple[float, ...]
    """Of maps estimated from all other photographs; () if fewer than two have flash."""
    by_first: tuple[float, ...]
    """Of maps estimated from the first photograph alone; () as by_others."""
    pictures: tuple[Prediction, ...] = ()
    """Of each photograph with flash, as predicted from the others."""
    shaded: tuple[float, ...] = ()
    """Share of each photograph's texels in shadow, which do not count; () as by_others."""

    @property
    def kept_first(self) -> tuple[float, float] | None:
        """Mean errors by each other and by the first, if the former are not clearly smaller."""
        pairs = [
            pair
            for pair in zip(self.by_others[1:], self.by_first[1:], strict=True)
            if all(map(math.isfinite, pair))
        ]
        if not pairs:
            return None
        others, first = (sum(errors) / len(pairs) for errors in zip(*pairs, strict=True))
        # Of two, either is predicted from one photograph, whoever's maps are better.
        share = _CLEARLY if len(pairs) > 1 else 1.0
        return (others, first) if others > share * first else None


@torch.no_grad()
def leave_one_out(
    alignment: Aligned, solved: Solved, prediction: Estimate, alone: Estimate, begun: SharedLight
) -> LeaveOneOut:
    """Predict every flash photograph from all others, and from the first.

    Texels that are far darker than all photographs together show do not count: a shadow tells
    nothing of the maps. The solution without a photograph starts from the registration of all, and
    from the network's prediction of the first photograph, even if that is the one left out. The
    photograph's gain is fitted to it.

    Args:
        solved: solution by all, whose light is the initial value.
        prediction: its prior.
        alone: maps by the first photograph.
        begun: its light, as its coarse fit has it.
    """
    estimates = prediction, alone, solved.estimate
    small, own, by_all = (each.coarser(_ACROSS, alignment.extent) for each in estimates)
    views, whole = alignment.on_grid(*small.maps.size), replace(solved, estimate=by_all)
    lit = [number for number, view in enumerate(views) if view.flash]
    if len(lit) < 2:
        return LeaveOneOut((), ())
    by_others, by_first, shaded = ([math.nan] * len(views) for _ in range(3))
    pictures = []
    for left_out in lit:
        views[left_out], shaded[left_out] = unshaded(views[left_out], by_all, solved.light)
    for left_out in lit:
        kept = [number for number in range(len(views)) if number != left_out]
        some, light = [views[number] for number in kept], solved.light.of_some(kept)
        without = solve(some, small, light, whole, rounds=_WITHOUT, sampled=_SAMPLED)
        by_others[left_out], predicted = left_out_residual(
            views[left_out], without.maps, without.light
        )
        pictures.append(Prediction.of(left_out + 1, views[left_out], predicted))
        by_first[left_out], _ = left_out_residual(views[left_out], own.maps, begun)
    return LeaveOneOut(tuple(by_others), tuple(by_first), tuple(pictures), tuple(shaded))


def unshaded(
    view: ResampledView, by_all: Estimate, light: SharedLight
) -> tuple[ResampledView, float]:
    """A photograph without the texels that a shadow darkens, and the share of these."""
    off = (view.log - as_photographed(view, parameters_of(by_all.maps), light)).mean(0)
    seen, dark = view.seen.all(0), off < -SHADOW
    share = float((seen & dark).sum() / seen.sum().clamp_min(1))
    return replace(view, seen=view.seen & ~dark), share


def left_out_residual(
    view: ResampledView, maps: MapSet, light: SharedLight
) -> tuple[float, Tensor]:
    """Median absolute residual of log radiance of a photograph not used for the maps, NaN without
    valid texels; and its rendering (as_photographed).
    """
    rendered = as_photographed(view, parameters_of(maps), light)
    return float((view.log - rendered)[view.seen].abs().nanmedian()), rendered


@dataclass(frozen=True)
class SetReport:
    """Result of a multi-view solve, by photograph."""

    views: tuple[RegisteredView, ...]
    """Registered photographs, the first one first."""
    residuals: tuple[float, ...]
    """Median |log radiance of photograph - re-rendering| of each."""
    predicted: tuple[float, ...]
    """Residuals of maps from all other photographs (set_report.py); NaN without flash; empty if
    not computed."""
    left_out: tuple[LeftOut, ...]
    """Photographs that could not be registered, with reasons."""
    measured: tuple[float, ...]
    """Share of albedo, F0, roughness and slope measured by photographs (Solved.measured)."""
    flash_offset: tuple[float, float, float]
    """Position of the flash relative to the lens, plane units; the last is 0."""
    mosaic: Mosaic
    """Extent of the maps; without margins, the first photograph's rectangle."""
    basis: SharedMaterials | None = None
    """Materials that the texels share; None if all are one."""
    kept_first: tuple[float, float] | None = None
    """Set if the result is that of the first photograph: residuals of all others predicted by each
    other and by the first, means."""
    pictures: tuple[Prediction, ...] = ()
    """Photographs predicted from the others; empty if not computed."""
    shaded: tuple[float, ...] = ()
    """Share of each photograph's texels in shadow (LeaveOneOut.shaded)."""
    frame: str | None = None
    """Registration.frame."""

    @staticmethod
    def alone(
        registration: Registration, setup: FlashSetup, size: tuple[int, int], residual: float
    ) -> SetReport:
        """Of a set of which only one photograph, of a `setup`, is left; `size` is that of maps."""
        only, left_out = registration.views[0], registration.left_out
        views, nothing = (replace(only, camera=PosedCamera.of(setup)),), (0.0,) * len(CHANNELS)
        known = (residual,), (), left_out, nothing, setup.offset, Mosaic.own(size)
        return SetReport(views, *known, frame=registration.frame)

    @staticmethod
    def of(
        alignment: Aligned,
        registration: Registration,
        solved: Solved,
        checked: LeaveOneOut,
        mosaic: Mosaic,
    ) -> SetReport:
        """Report of a solution and its check; the photographs measure nothing if it fails."""
        x, y = solved.light.offset.tolist()
        kept_first = None if mosaic.margins.any else checked.kept_first
        return SetReport(
            alignment.views,
            solved.residual,
            checked.by_others,
            registration.left_out,
            solved.measured if kept_first is None else (0.0,) * len(solved.measured),
            (x, y, 0.0),
            mosaic,
            solved.estimate.basis if kept_first is None else None,
            kept_first,
            checked.pictures,
            checked.shaded,
            registration.frame,
        )

    def by_view(self) -> Iterator[tuple[RegisteredView, float, float]]:
        """Each view with its residual and the residual of its prediction; NaN if not computed."""
        predicted = self.predicted or (math.nan,) * len(self.views)
        return zip(self.views, self.residuals, predicted, strict=True)

    def warning(self) -> str | None:
        """What is to be said of the frame, shadows, a set that did not help, uncertain cameras."""
        frame = [self.frame] if self.frame else []
        return " ".join([*frame, *self._shadows(), *self._doubts()]) or None

    def _shadows(self) -> Iterator[str]:
        for view, share in zip(self.views, self.shaded, strict=False):
            if share > SHADED:
                yield (
                    f"{100.0 * share:.0f} % of {view.photo.name} is far darker than the others "
                    "show, as in a shadow: that part of it tells nothing."
                )

    def _doubts(self) -> Iterator[str]:
        if len(self.views) < 2:
            yield (
                f"The maps are those of {self.views[0].photo.name} alone. Photograph the same "
                "sample again, sharp, with an overlap of two thirds."
            )
            return
        if self.kept_first is not None:
            each_other, first = self.kept_first
            yield (
                f"The photographs predict each other hardly better than {self.views[0].photo.name} "
                f"alone does, or worse (log radiance off by {each_other:.3f} and {first:.3f}): the "
                "maps are those of that photograph. Photograph again, sharp, in a dark room, "
                "without moving the sample."
            )
            return
        (limit,) = CHECKS["cameras"].limits
        uncertain = [view for view in self.views if view.position_deviation > limit]
        if uncertain:
            worst = max(view.position_deviation for view in uncertain)
            names = ", ".join(view.photo.name for view in uncertain)
            yield (
                f"Camera positions are uncertain by {100 * worst:.1f} % of their distance "
                f"({names}), and so are directions of light: the relief may be slightly tilted."
            )

    def document(self) -> dict[str, Any]:
        """JSON: angles in degrees, places in plane units."""
        return {
            "photographs": [
                {
                    "name": view.photo.name,
                    "flash": view.flash,
                    "matches": view.matches,
                    "correlation": view.correlation,
                    "position": view.camera.place.tolist(),
                    "tilt_degrees": math.degrees(view.camera.tilt),
                    "position_deviation": view.position_deviation,
                    "residual": residual,
                    "leave_one_out_residual": None if math.isnan(prediction) else prediction,
                }
                for view, residual, prediction in self.by_view()
            ],
            "left_out": [{"name": one.name, "reason": one.why} for one in self.left_out],
            "measured_share": dict(zip(CHANNELS, self.measured, strict=True)),
            "flash_offset": list(self.flash_offset[:2]),
            "lens_distortion": list(self.views[0].camera.lens.distortion),
            **({"mosaic": self.mosaic.document()} if self.mosaic.margins.any else {}),
            **({} if self.basis is None else {"materials": self.basis.document()}),
            "first_alone": self.kept_first is not None or len(self.views) < 2,
        }


# Diagram of cameras and lights over the sample, with each photograph's residuals.

# sRGB code values.
_INK, _PAPER, _FLASH, _LEFT_OUT = (225, 225, 225), (24, 24, 24), (255, 214, 90), (255, 110, 100)
_CAMERAS = (
    (120, 200, 255), (140, 230, 150), (255, 170, 110), (225, 150, 255), (255, 235, 130),
    (130, 225, 225), (255, 150, 170), (190, 190, 255),
)  # fmt: skip
_ROUND, _SPARK = 11, 4  # radii of the symbols of a camera and a flash, pixels
_MARGIN = 0.12  # around the diagram, as a share of its size
_LINE, _LETTER = 24, 8  # height of a line of text and width of a letter, pixels
_TRIPLES = 3  # predictions of photographs side by side


def draw_set(report: SetReport, exemplar: NDArray[np.float32], width: int) -> Image.Image:
    """Draw the sample with the cameras and flashes above it, and the report's lines.

    Args:
        report: cameras and residuals.
        exemplar: (H, W, 3) the exemplar from above, sRGB code values in [0, 1].
        width: of the picture, pixels.
    """
    part, tall, extent = width // 3, width // 4, report.mosaic.extent
    cameras = [view.camera for view in report.views]
    flashes = [camera.flash(report.flash_offset) for camera in cameras]
    half = extent.half * np.array([1.0, exemplar.shape[0] / exemplar.shape[1]])
    places = np.array([*(camera.place for camera in cameras), *flashes])[:, :2] - extent.middle
    # Pixels per plane unit at which the sample and all that is above it are shown.
    reach = (1.0 + _MARGIN) * np.maximum(half, np.abs(places).max(0))
    scale = 0.5 * min(part / reach[0], tall / reach[1])
    sheet, ink = _blank(width, tall, "from above")
    centre, size = 0.5 * np.array([part, tall]), np.rint(2.0 * scale * half).astype(int)
    codes = np.rint(np.clip(exemplar, 0.0, 1.0) * 255.0).astype(np.uint8)
    shown = Image.fromarray(codes).resize(tuple(size.tolist()))
    sheet.paste(shown, tuple(np.rint(centre - 0.5 * size).astype(int).tolist()))
    above = [tuple(place) for place in (centre + scale * places * [1.0, -1.0]).tolist()]
    font = ImageFont.load_default(size=14)
    for number, (view, place) in enumerate(zip(report.views, above, strict=False), 1):
        ink.circle(place, _ROUND, fill=_colour(number))
        ink.text(place, str(number), fill=_PAPER, font=font, anchor="mm")
        if view.flash:
            ink.circle(above[len(cameras) + number - 1], _SPARK, fill=_FLASH, outline=_PAPER)
    _write(report, ink, part + _ROUND, width)
    return sheet


def _write(report: SetReport, ink: ImageDraw.ImageDraw, left: int, right: int) -> None:
    """Write the report's lines, each in the colour of its photograph."""
    font, y = ImageFont.load_default(size=14), 2 * _LINE
    for text, number in set_report_lines(report):
        colour = _INK if number is None else _colour(number) if number else _LEFT_OUT
        for line in textwrap.wrap(text, (right - left - _ROUND) // _LETTER):
            ink.text((left, y), line, fill=colour, font=font)
            y += _LINE - 4


def draw_predicted(report: SetReport, width: int, *, turned: bool) -> Image.Image:
    """Draw each photograph, its prediction from the others, and their difference about grey.

    Args:
        report: with its pictures.
        width: of the drawing, pixels.
        turned: whether the photographs are shown upright, a quarter turn from the maps.
    """
    across = (width - _ROUND) // _TRIPLES
    rows = []
    for first in range(0, len(report.pictures), _TRIPLES):
        shown = [
            _triple(report, one, across - _ROUND, turned=turned)
            for one in report.pictures[first : first + _TRIPLES]
        ]
        row = Image.new("RGB", (width, shown[0].height), _PAPER)
        for number, picture in enumerate(shown):
            row.paste(picture, (_ROUND + number * across, 0))
        rows.append(np.asarray(row))
    return Image.fromarray(np.vstack(rows))


def _triple(report: SetReport, one: Prediction, width: int, *, turned: bool) -> Image.Image:
    """One photograph, its prediction and the difference of codes, twofold, side by side."""
    shown, predicted = (srgb_picture(each) for each in one[1:])
    triple = np.stack([shown, predicted, 0.5 + 2.0 * (predicted - shown)])
    codes = np.rint(np.clip(triple, 0.0, 1.0) * 255.0).astype(np.uint8)
    pictures = [standing(each) if turned else each for each in codes]
    tall = round(width / 3 * pictures[0].shape[0] / pictures[0].shape[1])
    view, error = report.views[one.number - 1], report.predicted[one.number - 1]
    label = f"{one.number} {view.photo.name}: photographed, predicted within {100.0 * error:.1f} %"
    sheet, _ = _blank(width, tall + _LINE + _ROUND, f"{label}, difference")
    for number, picture in enumerate(pictures):
        part = Image.fromarray(picture).resize((width // 3 - 2, tall))
        sheet.paste(part, (number * width // 3, _LINE))
    return sheet


def set_report_lines(report: SetReport) -> Iterator[tuple[str, int | None]]:
    """Lines of the report on several photographs, each with the number of its photograph.

    The number is None for lines on all photographs, and 0 for a photograph that was left out.
    """
    for number, (view, residual, prediction) in enumerate(report.by_view(), 1):
        line = f"{number} {view.photo.name}: re-rendered within {100.0 * residual:.1f} %"
        if not view.flash:
            line += ", without flash"
        elif not math.isnan(prediction):
            line += f", predicted from the others within {100.0 * prediction:.1f} %"
        yield line, number
    for one in report.left_out:
        yield f"left out: {one.name}, {one.why}", 0
    measured = zip(CHANNELS, report.measured, strict=True)
    shares = [f"{name} {100.0 * share:.0f} %" for name, share in measured]
    yield "measured, not predicted: " + ", ".join(shares), None
    if report.mosaic.margins.any:
        yield report.mosaic.summary(), None


def _colour(number: int) -> tuple[int, int, int]:
    """Colour of the photograph of a number, from 1."""
    return _CAMERAS[(number - 1) % len(_CAMERAS)]


def _blank(width: int, height: int, label: str) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    sheet = Image.new("RGB", (width, height), _PAPER)
    ink = ImageDraw.Draw(sheet)
    ink.text((_ROUND, 5), label, fill=_INK, font=ImageFont.load_default(size=16))
    return sheet, ink
