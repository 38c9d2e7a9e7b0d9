"""preview.png: everything about a capture on one sheet, to be judged by eye.

Two rows of equal panels (photograph, re-rendering, another light, the maps) and one row of crops
at one picture pixel a texel, where grain, weave and checkerboards show.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from matcap.files.srgb import srgb_picture
from matcap.files.staging import staged_file

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.capture.pipeline import CaptureResult

_COLUMNS = 4  # panels side by side
_CROP, _GAP, _LABEL = 256, 12, 26  # pixels
_PANEL = (2 * _COLUMNS * _CROP + (2 * _COLUMNS - 1) * _GAP - (_COLUMNS - 1) * _GAP) // _COLUMNS
_INK, _PAPER = (225, 225, 225), (24, 24, 24)  # sRGB code values
# From above and in front of the sample, in plane units: grazing enough to show relief.
_TOP_LIGHT = (0.0, 2.0, 1.2)
# A map's shown range is never narrower than this, or a flat map would show its rounding noise.
_LEAST_SPAN = {"specular": 0.02, "roughness": 0.05, "height": 0.002}


@dataclass(frozen=True)
class Panel:
    """A labelled picture of the sheet."""

    label: str
    pixels: NDArray[np.float32]  # (H, W, 3) code values in [0, 1]


def write_preview(result: CaptureResult, path: Path) -> None:
    """Write the sheet of a capture as an 8-bit sRGB PNG.

    Raises:
        MatcapError: the file cannot be written.
    """
    sheet = draw_sheet(result)
    with staged_file(path) as staged, staged.open("wb") as file:
        sheet.save(file, "PNG", compress_level=3)  # twice as fast as 6, a tenth larger


def draw_sheet(result: CaptureResult) -> Image.Image:
    """The sheet as an RGB picture."""
    shown = list(panels(result))
    height, width = shown[0].pixels.shape[:2]
    panel_height = max(1, round(_PANEL * height / width))
    rows = -(-len(shown) // _COLUMNS)
    size = (
        _GAP + _COLUMNS * (_PANEL + _GAP),
        rows * (_LABEL + panel_height + _GAP) + _LABEL + min(_CROP, height) + _GAP,
    )
    sheet = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=16)
    for index, panel in enumerate(shown):
        row, column = divmod(index, _COLUMNS)
        x, y = _GAP + column * (_PANEL + _GAP), row * (_LABEL + panel_height + _GAP)
        draw.text((x, y + 5), panel.label, fill=_INK, font=font)
        sheet.paste(_resized(panel.pixels, (_PANEL, panel_height)), (x, y + _LABEL))
    y = rows * (_LABEL + panel_height + _GAP)
    for index, panel in enumerate(shown):
        x = _GAP + index * (_CROP + _GAP)
        draw.text((x, y + 5), f"{panel.label.split(':')[0]}, 1:1", fill=_INK, font=font)
        sheet.paste(_image(_crop(panel.pixels)), (x, y + _LABEL))
    return sheet


def panels(result: CaptureResult) -> Iterable[Panel]:
    """Everything there is to see of a capture, as code values of the photograph's rectangle."""
    maps = result.maps
    relit = _relit(result)
    # Another light has no exposure of its own: it is shown as bright as the photograph.
    relit = relit * (float(result.rerendered.mean()) / max(float(relit.mean()), 1e-9))
    yield Panel("photograph", srgb_picture(result.rectified))
    yield Panel("re-rendered", srgb_picture(result.rerendered))
    yield Panel("light from the top", srgb_picture(relit))
    yield Panel("diffuse", srgb_picture(_picture(maps, "diffuse")))
    for kind in ("specular", "roughness", "height"):
        yield _stretched(kind, _picture(maps, kind))
    yield Panel("normal", 0.5 + 0.5 * _picture(maps, "normal"))


def _relit(result: CaptureResult) -> NDArray[np.float32]:
    """(H, W, 3) linear picture of the maps from the photograph's camera, lit from the top."""
    import torch

    from matcap.flash.geometry import plane_points
    from matcap.flash.render import shade

    width, height = result.maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    camera = torch.tensor([0.0, 0.0, result.material.setup.distance])
    with torch.no_grad():
        radiance = shade(result.maps, points, camera, torch.tensor(_TOP_LIGHT), torch.ones(3))
    picture: NDArray[np.float32] = radiance.movedim(0, -1).numpy()
    return picture


def _picture(maps: MapSet, kind: str) -> NDArray[np.float32]:
    """(H, W, C) of one map."""
    picture: NDArray[np.float32] = getattr(maps, kind).detach().movedim(0, -1).numpy()
    return picture


def _stretched(kind: str, values: NDArray[np.float32]) -> Panel:
    """Grey between the map's own ends, which the label tells."""
    low, high = (float(v) for v in np.quantile(values, (0.002, 0.998)))
    label = f"{kind}: {low:.3g} to {high:.3g}"
    short = max(_LEAST_SPAN[kind] - (high - low), 0.0)
    low, high = low - short / 2, high + short / 2
    grey = np.clip((values - low) / (high - low), 0.0, 1.0)
    return Panel(label, np.repeat(grey, 3, axis=2))


def _crop(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """The crop beside the middle: near the highlight, but not in it."""
    height, width = pixels.shape[:2]
    x = max(0, min(width // 4 - _CROP // 2, width - _CROP))
    y = max(0, (height - _CROP) // 2)
    return pixels[y : y + _CROP, x : x + _CROP]


def _resized(pixels: NDArray[np.float32], size: tuple[int, int]) -> Image.Image:
    import cv2

    shrinks = size[0] <= pixels.shape[1]
    way = cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    return _image(np.asarray(cv2.resize(pixels, size, interpolation=way), dtype=np.float32))


def _image(coded: NDArray[np.float32]) -> Image.Image:
    return Image.fromarray(np.rint(np.clip(coded, 0.0, 1.0) * 255.0).astype(np.uint8))
