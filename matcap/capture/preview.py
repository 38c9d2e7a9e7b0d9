"""preview.png: one sheet for visual inspection of a capture.

The material's block: panels (photograph, re-rendering, light from two sides, maps) and a row of
crops at one pixel per texel. The same panels of the decoder's material, if there are two, and of
the photographed rectangle, with crops at the same place. Of several photographs: a diagram of
cameras and flashes, and a block of the whole exemplar if it extends beyond the first photograph;
and each photograph's prediction from the others.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import ExemplarEstimate
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.multiview.set_report import draw_predicted, draw_set
from matcap.capture.result import CaptureResult
from matcap.capture.verdict.measurements import LIT, SIDES, lit_from, texels_of
from matcap.files.color import srgb_picture
from matcap.files.output import Output
from matcap.files.pixels import png_bytes
from matcap.flash.geometry import FlashSetup, points_of
from matcap.flash.light import render_flash, render_rectified
from matcap.flash.rectify import picture_of
from matcap.photo.checks import Rating, Region
from matcap.photo.photo import standing

Picture = NDArray[np.float32]

_COLUMNS = 4  # panels side by side
_CROP, _GAP, _LABEL = 256, 12, 26  # pixels
_PANEL = (2 * _COLUMNS * _CROP + (2 * _COLUMNS - 1) * _GAP - (_COLUMNS - 1) * _GAP) // _COLUMNS
_TITLE = 46  # pixels
# sRGB code values.
_INK, _TITLE_INK, _PAPER = (225, 225, 225), (255, 255, 255), (24, 24, 24)
_HATCH, _HATCH_INK = 12, (110, 110, 110)  # pixels between lines
_RATED = {
    Rating.GOOD: (111, 207, 143),
    Rating.USABLE: (225, 225, 225),
    Rating.DOUBTFUL: (240, 180, 41),
    Rating.FAILED: (255, 110, 100),
}
# Narrowest displayed range of a map: a flat map would show its rounding noise.
_CONSTANT = 0.05  # share of that range below which a map is constant, and shown as a number
_LEAST_SPAN = {"specular": 0.02, "roughness": 0.05, "height": 0.002}


@dataclass(frozen=True)
class Panel:
    """A labelled picture of the sheet."""

    label: str
    values: Picture
    """(H, W, 3) or (H, W), linear: averaged where the panel has fewer pixels."""
    code: Callable[[Picture], Picture] = srgb_picture
    """Function from values to code values in [0, 1], applied after averaging."""
    close: Picture | None = None
    """The crop at one pixel per texel, where `values` have fewer."""
    hidden: NDArray[np.bool_] | None = None
    """(H, W) of every texel: what the photograph does not show, which is hatched."""
    marked: Region | None = None
    """Region that the verdict is about."""
    number: str = ""
    """The value of a constant map, which is written in place of a picture."""

    def resized(self, size: tuple[int, int]) -> Image.Image:
        """The whole picture at a size of (width, height) pixels."""
        if self.number:
            return self._written(size)
        way = cv2.INTER_AREA if size[0] <= self.values.shape[1] else cv2.INTER_NEAREST
        image = self._image(
            np.asarray(cv2.resize(self.values, size, interpolation=way), np.float32)
        )
        if self.hidden is None:
            return image
        hidden = cv2.resize(self.hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        return hatched(image, hidden > 0)

    def enlarged(self, by: float) -> Panel:
        """The panel with `by` times as many pixels a side; its crop has the same middle."""
        if self.number or by <= 1.0:
            return self
        close = self.values if self.close is None else self.close
        cubic = cv2.resize(close, None, fx=by, fy=by, interpolation=cv2.INTER_CUBIC)
        # A cubic kernel overshoots edges, below 0 too, which no code value is defined for.
        wide: Picture = np.asarray(np.clip(cubic, close.min(), close.max()), np.float32)
        if self.close is None:
            return replace(self, values=wide)
        height, width = close.shape[:2]
        top, left = (wide.shape[0] - height) // 2, (wide.shape[1] - width) // 2
        return replace(self, close=wide[top : top + height, left : left + width])

    def crop(self) -> Image.Image:
        """Crop at one pixel per texel, at a quarter of the width, next to the highlight."""
        height, width = self.values.shape[:2]
        if self.number:
            return self._written((min(_CROP, width), min(_CROP, height)))
        close = self.values[_crop(width, height)] if self.close is None else self.close
        image = self._image(close)
        if self.hidden is None:
            return image
        return hatched(image, self.hidden[_crop(self.hidden.shape[1], self.hidden.shape[0])])

    def _written(self, size: tuple[int, int]) -> Image.Image:
        image, font = Image.new("RGB", size, _PAPER), ImageFont.load_default(size=32)
        middle = (size[0] / 2, size[1] / 2)
        ImageDraw.Draw(image).text(middle, self.number, fill=_INK, font=font, anchor="mm")
        return image

    def _image(self, values: Picture) -> Image.Image:
        code = np.rint(np.clip(self.code(values), 0.0, 1.0) * 255.0)
        return Image.fromarray(code.astype(np.uint8)).convert("RGB")


def hatched(image: Image.Image, where: NDArray[np.bool_]) -> Image.Image:
    """A picture with diagonal lines in place of some of its pixels (H, W)."""
    pixels = np.array(image)
    row, column = np.nonzero(where)
    line = ((row + column) % _HATCH < _HATCH // 4)[:, None]
    pixels[row, column] = np.where(line, _HATCH_INK, _PAPER)
    return Image.fromarray(pixels)


def _crop(width: int, height: int) -> tuple[slice, slice]:
    """Rows and columns of the crop of a picture."""
    x = max(0, min(width // 4 - _CROP // 2, width - _CROP))
    y = max(0, (height - _CROP) // 2)
    return slice(y, y + _CROP), slice(x, x + _CROP)


def _developed(
    label: str, result: CaptureResult, linear: Picture, close: Picture | None = None
) -> Panel:
    """Panel of a linear picture (H, W, 3) under the photograph's tone curve, as sRGB."""
    return Panel(label, linear, lambda some: srgb_picture(result.photo.developed(some)), close)


def write_preview(result: CaptureResult, path: Path) -> None:
    """Write the sheet of a capture as an 8-bit sRGB PNG, all or nothing.

    Raises:
        MatcapError: the file cannot be written.
    """
    sheet = draw_sheet(result)
    with Output.file(path) as staged, staged.open("wb") as file:
        file.write(png_bytes(np.asarray(sheet)))  # in half of Pillow's time


def draw_sheet(result: CaptureResult) -> Image.Image:
    """Draw the sheet of a capture, RGB."""
    blocks = [block(list(panels(result)))]
    if result.estimate is not None:
        made = result.material.generators
        generator = "by example" if "example" in made else "by the decoder"
        if result.choice is not None:
            decoded = block(list(decoder_panels(result, result.choice.decoded)))
            enlarged = result.rectified.shape[1] / result.choice.decoded.diffuse.shape[-1]
            times = f", enlarged {enlarged:.3g} times" if enlarged > 1.0 else ""
            blocks.append(titled(decoded, f"The material, by the decoder{times}"))
        exemplar = block(list(exemplar_panels(result, result.estimate)))
        blocks = [
            titled(blocks[0], f"The material, {generator}"),
            *blocks[1:],
            titled(exemplar, "The photographed rectangle itself"),
        ]
        several = result.several
        if several is not None:
            maps = map_set_of(result.estimate.exemplar)
            if several.mosaic.margins.any:
                whole = block(list(lit_panels(maps, result.rerendered, result.material.setup)))
                blocks.append(titled(whole, several.mosaic.summary()))
            seen = srgb_picture(_picture(maps, "diffuse"))
            # Cameras are in landscape coordinates; so must be the picture below them.
            landscape = np.ascontiguousarray(np.rot90(seen)) if result.estimate.turned else seen
            drawn = draw_set(several, landscape, blocks[0].width)
            blocks.append(titled(drawn, "Cameras and flashes"))
            if several.pictures:
                turned = result.estimate.turned
                drawn = draw_predicted(several, blocks[0].width, turned=turned)
                blocks.append(titled(drawn, "Each photograph, predicted from the others"))
    blocks.insert(0, _headline(result, blocks[0].width))
    return stacked(blocks)


def stacked(blocks: Sequence[Image.Image]) -> Image.Image:
    """Stack pictures of equal width vertically."""
    return Image.fromarray(np.vstack([np.asarray(shown) for shown in blocks]))


def _headline(result: CaptureResult, width: int) -> Image.Image:
    """Banner of a width in pixels: the verdict, and the exposure of the pictures."""
    verdict, exposure = result.verdict, result.photo.exposure
    shown = "Pictures are at the photograph's exposure; those under other lights, at its mean."
    if exposure is not None:
        shown += f" The photograph's: time x ISO / f-number^2 = {exposure:.3g}."
    if result.choice is not None:
        shown = f"{result.choice.sentence()} {shown}"
    font = ImageFont.load_default(size=20)
    paragraphs = ((f"Verdict: {verdict.sentence()}", _RATED[verdict.rating]), (shown, _INK))
    lines = [(line, ink) for text, ink in paragraphs for line in _wrapped(text, font, width)]
    banner = Image.new("RGB", (width, 20 + 28 * len(lines)), _PAPER)
    draw = ImageDraw.Draw(banner)
    for row, (line, ink) in enumerate(lines):
        draw.text((_GAP, 12 + 28 * row), line, fill=ink, font=font)
    return banner


def _wrapped(
    text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int
) -> list[str]:
    """Lines of a text that fit into a width in pixels, without the gaps at its sides."""
    letters = int(0.95 * (width - 2 * _GAP) * len(text) / max(1.0, font.getlength(text)))
    return textwrap.wrap(text, max(8, letters))


def panels(result: CaptureResult) -> Iterable[Panel]:
    """Panels of a material, over a rectangle as large as the photograph."""
    worst = result.verdict.worst
    marked = None if worst.rating is Rating.GOOD else worst.where  # small differences have no place
    yield replace(_photograph(result), marked=marked)
    yield replace(_developed("re-rendered", result, result.rerendered), marked=marked)
    yield from lit_panels(result.maps, result.rerendered, result.material.setup)


def exemplar_panels(result: CaptureResult, estimate: ExemplarEstimate) -> Iterable[Panel]:
    """Panels of an exemplar, as panels()."""
    maps, setup = map_set_of(estimate.first_rectangle), result.material.setup
    whole, close = _under_flash(maps, setup)
    photograph = _photograph(result)
    yield photograph
    shown = (_developed("re-rendered", result, whole, close), *lit_panels(maps, whole, setup))
    for panel in shown:
        yield replace(panel, hidden=photograph.hidden)


def decoder_panels(result: CaptureResult, maps: MapSet) -> Iterable[Panel]:
    """Panels of the decoder's field beside that by example, as panels(), at the same scale."""
    with torch.inference_mode():
        rerendered = picture_of(render_rectified(maps, result.material.setup))
    photograph = _photograph(result)
    yield photograph
    by = photograph.values.shape[1] / rerendered.shape[1]
    yield _developed("re-rendered", result, rerendered).enlarged(by)
    for panel in lit_panels(maps, rerendered, result.material.setup):
        yield panel.enlarged(by)


def _photograph(result: CaptureResult) -> Panel:
    """Panel of the photograph, the texels that it does not show hatched."""
    kept = None if result.estimate is None else result.estimate.kept
    shown = _developed("photograph", result, result.rectified)
    return shown if kept is None else replace(shown, hidden=~kept)


def lit_panels(maps: MapSet, rerendered: Picture, setup: FlashSetup) -> Iterable[Panel]:
    """Panels of maps under light from two sides (relit), and of each map.

    Normals are the height's gradient: the light from two sides shows them.
    """
    for side in SIDES:
        yield relit(side, maps, rerendered, setup)
    yield from each_map(maps)


def block(shown: Sequence[Panel]) -> Image.Image:
    """Lay out panels in rows of four, and their crops at one pixel per texel below."""
    height, width = shown[0].values.shape[:2]
    panel_height = max(1, round(_PANEL * (height / width)))
    pitch = _LABEL + panel_height + _GAP
    panels_height = -(-len(shown) // _COLUMNS) * pitch
    crop_height = min(_CROP, max(panel.values.shape[0] for panel in shown))
    size = _GAP + _COLUMNS * (_PANEL + _GAP), panels_height + _LABEL + crop_height + _GAP
    sheet = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=16)
    for index, panel in enumerate(shown):
        row, column = divmod(index, _COLUMNS)
        x, y = _GAP + column * (_PANEL + _GAP), row * pitch
        draw.text((x, y + 5), panel.label, fill=_INK, font=font)
        sheet.paste(panel.resized((_PANEL, panel_height)), (x, y + _LABEL))
        if panel.marked is not None:
            left, top, wide, high = panel.marked
            ends = ((max(left, 0.0), max(top, 0.0)), (min(left + wide, 1.0), min(top + high, 1.0)))
            box = [(x + u * _PANEL, y + _LABEL + v * panel_height) for u, v in ends]
            draw.rectangle(box, outline=_RATED[Rating.DOUBTFUL], width=3)
    for index, panel in enumerate(shown):
        x, y = _GAP + index * (_CROP + _GAP), panels_height
        draw.text((x, y + 5), f"{panel.label.split(':')[0]}, 1:1", fill=_INK, font=font)
        sheet.paste(panel.crop(), (x, y + _LABEL))
    return sheet


def titled(shown: Image.Image, title: str) -> Image.Image:
    """Add a title above a picture, wrapped to its width."""
    font = ImageFont.load_default(size=24)
    lines = _wrapped(title, font, shown.width)
    heading = Image.new("RGB", (shown.width, _TITLE * max(1, len(lines))), _PAPER)
    ink = ImageDraw.Draw(heading)
    for row, line in enumerate(lines):
        ink.text((_GAP, 12 + _TITLE * row), line, fill=_TITLE_INK, font=font)
    return stacked([heading, shown])


def each_map(maps: MapSet) -> Iterable[Panel]:
    """A panel for each map but normals: colours as sRGB, a coloured F0 with its mean in the label,
    others stretched to their range.
    """
    yield Panel("diffuse", _picture(maps, "diffuse"))
    specular = _picture(maps, "specular")
    if len(maps.specular) > 1:
        mean = " ".join(f"{value:.2f}" for value in specular.mean(axis=(0, 1)))
        yield Panel(f"specular: {mean} on average", specular)
    else:
        yield _stretched("specular", specular)
    for kind in ("roughness", "height"):
        yield _stretched(kind, _picture(maps, kind))


def relit(side: str, maps: MapSet, rerendered: Picture, setup: FlashSetup) -> Panel:
    """Render maps from the photograph's camera under a light of SIDES: some texels, and the crop.

    Scaled to the mean radiance of the re-rendering, as this light has no exposure of its own.
    """
    width, height = maps.size
    every = slice(None, None, max(1, width // LIT))
    whole = lit_from(side, maps, setup, every, every)
    gain = np.float32(rerendered.mean() / max(float(whole.mean()), 1e-9))
    close = gain * lit_from(side, maps, setup, *_crop(width, height))
    return Panel(f"light from the {side}", gain * whole, close=close)


def _under_flash(maps: MapSet, setup: FlashSetup) -> tuple[Picture, Picture]:
    """Render maps under the setup's flash: some texels, and the crop."""
    turned, setup = setup.turned, replace(setup, turned=False)
    landscape = maps.turned(1) if turned else maps
    width, height = landscape.size
    every = slice(None, None, max(1, width // LIT))

    @torch.no_grad()
    def lit(rows: slice, columns: slice) -> Picture:
        points = points_of((height, width), rows, columns=columns)
        some = texels_of(landscape, rows, columns)
        radiance = render_flash(some, setup, points).movedim(0, -1).numpy()
        return standing(radiance) if turned else np.ascontiguousarray(radiance)

    rows, columns = _crop(*maps.size)
    if turned:  # its right side is the top of the landscape picture
        rows, columns = slice(max(0, height - columns.stop), height - columns.start), rows
    return lit(every, every), lit(rows, columns)


def _picture(maps: MapSet, kind: str) -> Picture:
    """(H, W, C) of one map."""
    picture: Picture = getattr(maps, kind).detach().movedim(0, -1).contiguous().numpy()
    return picture


def _stretched(kind: str, values: Picture) -> Panel:
    """Panel of a scalar map, its 0.2 and 99.8 % quantiles as black and white and in the label."""
    some = slice(None, None, max(1, values.shape[1] // LIT))
    low, high = (float(v) for v in np.quantile(values[some, some], (0.002, 0.998)))
    label = f"{kind}: {low:.3g} to {high:.3g}"
    if high - low < _CONSTANT * _LEAST_SPAN[kind]:
        number = f"{(low + high) / 2:.3g}"
        return Panel(f"{kind}: one value", values[..., 0], number=number)
    short = max(_LEAST_SPAN[kind] - (high - low), 0.0)
    low, high = low - short / 2, high + short / 2
    return Panel(label, values[..., 0], lambda some: (some - low) / (high - low))
