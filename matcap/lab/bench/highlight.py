"""Whether the coarse fit keeps a photograph's highlight, and finds flash and tilt where they were.

Real photographs have no truth but themselves: the highlight is measured alike in photograph and
re-rendering (flash/highlight.py). Simulated ones tell offset and tilt.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.capture.verdict.checks import plain
from matcap.files.picture import write_picture
from matcap.flash.coarse import CoarseFit, fit_coarse, render_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.highlight import CELLS, Highlight, find_highlight, light_of
from matcap.lab.simulate.materials import random_material
from matcap.lab.simulate.materials.kinds import random_kind
from matcap.lab.simulate.photograph import PhoneCamera, as_photo, take
from matcap.photo.photo import DEFAULT_FOV, Photo

# What keeping it means: plane units between centres, and shares of width and of contrast.
CENTRE, WIDTH, CONTRAST = 0.03, 0.2, 0.2
# Simulated photographs: degrees across, plane units of offset, degrees of tilt.
_FOV, _OFFSET, _TILT = (40.0, 90.0), (0.02, 0.2), 15.0
_CAMERA = (512, 384)


@dataclass(frozen=True)
class Kept:
    """A photograph's highlight beside its re-rendering's.

    Attributes:
        name: of the photograph.
        photograph: its highlight.
        rendering: the re-rendering's, or None where nothing stands out.
        seconds: of processor time that the fit took.
    """

    name: str
    photograph: Highlight
    rendering: Highlight | None
    seconds: float

    @property
    def apart(self) -> float:
        """Between the centres, plane units."""
        if self.rendering is None:
            return math.inf
        return math.dist(self.photograph.centre, self.rendering.centre)

    @property
    def width(self) -> float:
        """The re-rendering's width over the photograph's."""
        return 0.0 if self.rendering is None else self.rendering.width / self.photograph.width

    @property
    def contrast(self) -> float:
        """Likewise of the peak over its surroundings."""
        return 0.0 if self.rendering is None else self.rendering.contrast / self.photograph.contrast

    @property
    def whole(self) -> bool:
        """Whether place, width and contrast are all kept."""
        return (
            self.apart <= CENTRE
            and abs(self.width - 1.0) <= WIDTH
            and abs(self.contrast - 1.0) <= CONTRAST
        )


@dataclass(frozen=True)
class Placed:
    """Errors of offset (plane units) and tilt (degrees) on a simulated photograph.

    Attributes:
        kind: of the material.
        visible: whether its highlight is plain to see.
        offset, tilt: the errors.
    """

    kind: str
    visible: bool
    offset: float
    tilt: float


def keep(photo: Photo) -> tuple[Kept | None, CoarseFit | None]:
    """Fit a photograph and compare highlights; None where none is plain to see."""
    found = find_highlight(light_of(photo.pixels))
    if found is None or not plain(found):
        return None, None
    start = time.process_time()
    fit = fit_coarse(photo)
    seconds = time.process_time() - start
    return Kept(
        photo.name, found, find_highlight(_rerendered(fit, photo).mean(axis=2)), seconds
    ), fit


def _rerendered(fit: CoarseFit, photo: Photo) -> NDArray[np.float64]:
    """(h, CELLS, 3) what the camera would have seen of the fit, clipped as it clips."""
    rows, columns = photo.pixels.shape[:2]
    return np.minimum(render_coarse(fit, CELLS, max(8, round(CELLS * rows / columns))), 1.0)


def write_pair(fit: CoarseFit, photo: Photo, path: Path) -> None:
    """Photograph and re-rendering side by side, sRGB."""
    again = _rerendered(fit, photo).astype(np.float32)
    height, width = again.shape[:2]
    small = cv2.resize(photo.pixels, (width, height), interpolation=cv2.INTER_AREA)
    write_picture(np.concatenate([np.minimum(small, 1.0), again], axis=1), path)


def simulated(
    count: int, seed: int, *, tells_fov: bool = True
) -> Iterator[tuple[str, Photo, FlashSetup]]:
    """(kind of material, photograph, true setup): RAW, any field of view, offset and tilt.

    Args:
        count: how many.
        seed: of materials and setups.
        tells_fov: False for files that do not tell their field of view, which is assumed then.
    """
    rng = np.random.default_rng(seed)
    width, height = _CAMERA
    for number in range(count):
        material = random_kind(rng) if number % 3 else random_material(rng)
        half = math.tan(math.radians(rng.uniform(*_FOV)) / 2.0)
        away, towards = rng.uniform(*_OFFSET), rng.uniform(0.0, 2.0 * math.pi)
        lean, about = math.radians(rng.uniform(0.0, _TILT)), rng.uniform(0.0, 2.0 * math.pi)
        setup = FlashSetup(
            offset=(away * math.cos(towards), away * math.sin(towards), 0.0),
            tilt=(lean * math.cos(about), lean * math.sin(about)),
            vignetting=0.02,
        )
        camera = PhoneCamera(
            width=width, height=height, focal_length=round(18.0 / half), supersampling=1, blur=0.5
        )

        def piece(width: int, height: int, texel: float) -> MapSet:
            return material.realise(width, height, number, texel)  # noqa: B023

        shot = take(piece, camera, setup)
        name = getattr(material, "kind", "pattern")
        photo = as_photo(shot, number, f"{name} {number}")
        if not tells_fov:
            photo = replace(photo, fov=DEFAULT_FOV, fov_source="assumed")
        yield name, photo, shot.setup


def place(kind: str, photo: Photo, truth: FlashSetup) -> Placed:
    """Errors of the coarse fit of a simulated photograph."""
    fit = fit_coarse(photo)
    found = fit.setup
    return Placed(
        kind,
        plain(find_highlight(light_of(photo.pixels))),
        math.dist(found.offset[:2], truth.offset[:2]),
        math.degrees(math.dist(found.tilt, truth.tilt)),
    )


def markdown(kept: Sequence[Kept], placed: Sequence[Placed], command: str) -> str:
    """Both tables, and the command that made them."""
    return "\n".join([f"`{command}`", "", *_kept_table(kept), *_placed_table(placed)])


def _kept_table(kept: Sequence[Kept]) -> Iterable[str]:
    if not kept:
        return
    yield "| photograph | centres apart | width | contrast | kept |"
    yield "| --- | --- | --- | --- | --- |"
    for one in kept:
        told = f"{one.apart:.3f} | {one.width:.2f} | {one.contrast:.2f}"
        yield f"| {one.name} | {told} | {'yes' if one.whole else 'no'} |"
    share = sum(one.whole for one in kept) / len(kept)
    seconds = statistics.fmean(one.seconds for one in kept)
    yield f"\nKept whole: {share:.0%} of {len(kept)}, in {seconds:.1f} s of processor time each.\n"


def _placed_table(placed: Sequence[Placed]) -> Iterable[str]:
    if not placed:
        return
    yield "| simulated | number | offset median | worst | tilt median | worst | beyond |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    groups: tuple[tuple[str, Callable[[Placed], bool]], ...] = (
        ("all", lambda one: True),
        ("highlight plain to see", lambda one: one.visible),
        ("none", lambda one: not one.visible),
    )
    for name, of in groups:
        group = [one for one in placed if of(one)]
        if group:
            offsets, tilts = [one.offset for one in group], [one.tilt for one in group]
            beyond = sum(one.offset > 0.1 or one.tilt > 5.0 for one in group)
            yield (
                f"| {name} | {len(group)} | {statistics.median(offsets):.3f} | {max(offsets):.3f} "
                f"| {statistics.median(tilts):.2f}° | {max(tilts):.2f}° | {beyond} |"
            )
