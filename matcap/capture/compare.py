"""Comparison picture of captures: photographs, renderings under equal lights, maps, verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from matcap.capture.outputs import REPORT
from matcap.capture.preview import Panel, block, each_map, relit, stacked, titled
from matcap.field.material import Material
from matcap.field.opened import open_material
from matcap.files.document import read_document
from matcap.flash.rectify import picture_of, rectify
from matcap.flash.render import render_rectified
from matcap.photo.orient import standing
from matcap.photo.photo import Photo
from matcap.photo.tone import ToneCurve


@dataclass(frozen=True)
class Compared:
    """A capture to be compared."""

    name: str
    """Name of the material."""
    material: Material
    """The captured material."""
    verdict: dict[str, Any] | None
    """`verdict` of its report.json; None without a report."""
    photograph: Path | None = None
    """Path of the photograph by report.json; the file may no longer exist."""
    tone: ToneCurve = ToneCurve()
    """Tone curve of the photograph by report.json."""

    @staticmethod
    def open(path: Path) -> Compared:
        """Open the folder of a capture, or its .matcap file.

        Raises:
            MatcapError: the path holds no material, or several.
        """
        file, material = open_material(path)
        report = read_document(file.parent / REPORT, "matcap report") or {}
        tone = ToneCurve.of_report(report)
        return Compared(file.stem, material, _verdict(report), _photograph(report), tone)

    def title(self) -> str:
        """Title of its panels: name and verdict."""
        said = self.verdict["sentence"] if self.verdict else "without a verdict"
        return f"{self.name}: {said}"


def comparison(captures: Sequence[Compared], photographs: Sequence[Photo | None]) -> Image.Image:
    """Draw a block of panels for each capture, with its photograph if given, one below another."""
    blocks = []
    for capture, photo in zip(captures, photographs, strict=True):
        photo = photo and photo.linearised(capture.tone)
        blocks.append(titled(block(list(_panels(capture.material, photo))), capture.title()))
    return stacked(blocks)


def _panels(material: Material, photo: Photo | None) -> Iterator[Panel]:
    """Photograph, re-rendering, two other lights and the maps of a capture."""
    setup, width = material.setup, round(2.0 / material.texel_size)
    height = round(width * 3 / 4)
    if photo is not None:
        height = round(width * photo.pixels.shape[0] / photo.pixels.shape[1])
        linear = picture_of(rectify(photo, setup, width)[0])
        yield Panel("photograph", standing(linear) if setup.turned else linear)
    if setup.turned:
        width, height = height, width
    maps = material.maps(width, height)
    with torch.inference_mode():
        rendered = picture_of(render_rectified(maps, setup))
    yield Panel("re-rendered", rendered)
    for side in ("left", "top"):
        yield relit(side, maps, rendered, setup)
    yield from each_map(maps)


def _verdict(report: dict[str, Any]) -> dict[str, Any] | None:
    verdict = report.get("verdict")
    return verdict if isinstance(verdict, dict) and "sentence" in verdict else None


def _photograph(report: dict[str, Any]) -> Path | None:
    photograph = report.get("photograph")
    path = photograph.get("path") if isinstance(photograph, dict) else None
    return Path(path) if isinstance(path, str) else None
