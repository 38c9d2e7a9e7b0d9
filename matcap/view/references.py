"""Reference data of a material in the viewer: photograph, verdict of its capture, doubt mask."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from matcap.example.example import Example
from matcap.files.document import read_document
from matcap.files.picture import jpeg_bytes
from matcap.files.png import png_bytes
from matcap.photo.kind import RAW_SUFFIXES

if TYPE_CHECKING:
    from matcap.example.exemplar import Exemplar
    from matcap.field.material import Material
    from matcap.flash.geometry import FlashSetup
    from matcap.photo.tone import ToneCurve

_LONG_SIDE = 1024
_PHOTOGRAPHS = (
    *(".dng", ".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic", ".avif", ".webp", ".exr", ".hdr"),
    *sorted(RAW_SUFFIXES),
)
_DOUBT = (236, 118, 52)  # sRGB of the doubt mask, a colour that few materials have
_OPAQUE = 200  # alpha, of 255, at confidence 0


@dataclass(frozen=True)
class EncodedPicture:
    """An encoded image for the browser."""

    data: bytes
    """Bytes of the file."""
    kind: str
    """Media type."""

    @property
    def url(self) -> str:
        """The picture as a data URL."""
        return f"data:{self.kind};base64,{base64.b64encode(self.data).decode()}"


@dataclass(frozen=True)
class References:
    """Reference data of a material; None for what does not exist."""

    photo: EncodedPicture | None = None
    """The photograph, rectified where the material has an exemplar."""
    doubt: EncodedPicture | None = None
    """Overlay of the exemplar, more opaque where its confidence is lower."""
    verdict: tuple[str, str] | None = None
    """(rating, sentence) of the capture's verdict."""


def find_references(
    path: Path, name: str, photo: Path | None = None, material: Material | None = None
) -> References:
    """Collect the reference data of a material or map set, from its folder and its file.

    Args:
        path: of its file or folder.
        photo: file to use instead of the folder's photograph.
        material: the material; None for a map set.

    Raises:
        MatcapError: the photograph cannot be read.
    """
    from matcap.photo.tone import ToneCurve

    folder = path if path.is_dir() else path.parent
    file = photo or find_photograph(path, name) or reported_photograph(folder)
    example = material.part(Example) if material else None
    setup = material.setup if material and example else None
    report = read_document(folder / "report.json", "matcap report") or {}
    tone = ToneCurve.of_report(report)
    return References(
        browser_picture(file, setup, tone) if file else None,
        doubt_picture(example.exemplar) if example else None,
        read_verdict(folder),
    )


def find_photograph(path: Path, name: str) -> Path | None:
    """The photograph in a folder: a file with the material's name, or named photo; or None."""
    folder = path if path.is_dir() else path.parent
    for suffix in _PHOTOGRAPHS:
        for file in (folder / f"{name}{suffix}", folder / f"photo{suffix}"):
            if file.is_file():
                return file
    return None


def reported_photograph(folder: Path) -> Path | None:
    """The photograph whose path a capture's report has, if it exists."""
    try:
        file = Path((read_document(folder / "report.json") or {})["photograph"]["path"])
    except (KeyError, TypeError):
        return None
    return file if file.is_file() else None


def read_verdict(folder: Path) -> tuple[str, str] | None:
    """(rating, sentence) of the verdict in a capture's report, or None."""
    try:
        verdict = (read_document(folder / "report.json") or {})["verdict"]
        return str(verdict["rating"]), str(verdict["sentence"])
    except (KeyError, TypeError):
        return None


def browser_picture(
    file: Path, setup: FlashSetup | None = None, tone: ToneCurve | None = None
) -> EncodedPicture:
    """A photograph as a JPEG of at most 1024 pixels a side.

    Args:
        setup: camera and flash, by which it is rectified; None leaves it as it is.
        tone: the tone curve that is removed, as the page renders without one.

    Raises:
        MatcapError: the file is not a photograph that matcap reads.
    """
    from matcap.photo.load import load_photo
    from matcap.photo.orient import standing

    photo = load_photo(file, long_side=_LONG_SIDE, noise=False)
    photo = photo if tone is None else photo.linearised(tone)
    linear = photo.pixels
    if setup is not None:
        from matcap.flash.rectify import picture_of, rectify

        linear = picture_of(rectify(photo, setup, linear.shape[1])[0])
    # Portrait photographs are read in landscape orientation; maps are upright if setup.turned.
    if photo.turned if setup is None else setup.turned:
        linear = standing(linear)
    return EncodedPicture(jpeg_bytes(linear, 88), "image/jpeg")


def doubt_picture(exemplar: Exemplar) -> EncodedPicture:
    """Overlay of an exemplar as PNG: _DOUBT with alpha _OPAQUE (1 - mean confidence)."""
    step = max(1, max(exemplar.size) // _LONG_SIDE)
    trusted = exemplar.confidence.mean(axis=0)[::step, ::step]
    shade = np.empty((*trusted.shape, 4), np.uint8)
    shade[..., :3] = _DOUBT
    shade[..., 3] = np.rint(_OPAQUE * (1.0 - trusted))
    return EncodedPicture(png_bytes(shade), "image/png")
