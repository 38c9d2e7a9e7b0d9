"""Comparable pictures of photographs and materials: central crops at one exposure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.material import Material
from matcap.files.output import Output
from matcap.files.srgb import srgb_encode_tensor
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.render import render_flash
from matcap.lab.train.corpus import LONG_SIDE, simulated_code
from matcap.lab.train.pack import Entry, encode, linear_of

SIZE = 256  # texels a side of what is compared
_MEAN = 0.25  # radiance that every picture is brought to
_SHOWN = 192  # texels a side of a picture on a sheet
_QUALITY = 85


def middle(entry: Entry) -> Tensor:
    """(3, SIZE, SIZE) sRGB, the middle of a photograph of the pack."""
    return _exposed(_cut(torch.from_numpy(entry.photo().pixels.transpose(2, 0, 1).copy())))


def simulated_middle(seed: int) -> Tensor:
    """(3, SIZE, SIZE) sRGB, the middle of a simulated photograph."""
    return _exposed(_cut(linear_of(simulated_code(seed)[0])))


def lit(material: Material) -> Tensor:
    """lit_maps() of a material, under its own flash."""
    return lit_maps(material.maps(SIZE, SIZE), material.setup)


def lit_maps(maps: MapSet, setup: FlashSetup) -> Tensor:
    """(3, SIZE, SIZE) sRGB of maps lying in the middle of a photograph, under a flash."""
    width, height = LONG_SIDE, LONG_SIDE * 3 // 4
    x, y = (width - SIZE) // 2, (height - SIZE) // 2
    points = plane_points(x, y, SIZE, SIZE, (width, height), dtype=torch.float32)
    with torch.inference_mode():
        return _exposed(render_flash(maps, setup, points))


def write_grid(pictures: Sequence[Tensor], columns: int, path: Path) -> None:
    """Write a JPEG grid of sRGB pictures (3, H, W) of one size, `columns` wide.

    Raises:
        MatcapError: the file cannot be written.
    """
    blank = torch.zeros_like(pictures[0])
    padded = [*pictures, *[blank] * (-len(pictures) % columns)]
    rows = [torch.cat(padded[i : i + columns], dim=2) for i in range(0, len(padded), columns)]
    code = torch.cat(rows, dim=1).permute(1, 2, 0).numpy()[..., ::-1]
    share = _SHOWN / pictures[0].shape[-2]
    small = cv2.resize(code, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    stored = np.ascontiguousarray((small * 255.0).round().astype(np.uint8))
    with Output.file(path) as file:
        file.write_bytes(encode(stored, _QUALITY))


def _cut(linear: Tensor) -> Tensor:
    """Central crop of (3, H, W), of at most SIZE texels a side."""
    y, x = (max(0, side - SIZE) // 2 for side in linear.shape[-2:])
    return linear[:, y : y + SIZE, x : x + SIZE]


def _exposed(linear: Tensor) -> Tensor:
    """SRGB of radiance (3, H, W), scaled to the common mean."""
    gain = _MEAN / linear.mean().clamp_min(1e-6)
    return srgb_encode_tensor((linear * gain).clamp(0.0, 1.0))
