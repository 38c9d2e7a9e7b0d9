"""Reference data of a material in the viewer: photograph, verdict of its capture, doubt mask."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from matcap.example.example import Example

if TYPE_CHECKING:
    from matcap.example.exemplar import Exemplar
    from matcap.field.material import Material
    from matcap.flash.geometry import FlashSetup

_LONG_SIDE = 1024
_PHOTOGRAPHS = (
    *(".dng", ".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic", ".avif", ".webp"),
    *(".cr2", ".nef", ".arw"),
)
_DOUBT = (236, 118, 52)  # of what is not trusted: no colour of most materials
_OPAQUE = 200  # of 255, where the photograph says nothing


@dataclass(frozen=True)
class EncodedPicture:
    """A picture that a browser shows."""

    data: bytes
    """A file's bytes."""
    kind: str
    """Its media type."""


@dataclass(frozen=True)
class References:
    """Reference data of a material; None for what there is not."""

    photo: EncodedPicture | None = None
    """The photograph; of a piece that is known, as seen from straight above it."""
    doubt: EncodedPicture | None = None
    """Over the photographed piece, shaded where the photograph says little."""
    verdict: tuple[str, str] | None = None
    """(rating, sentence) on the capture, or none."""


def find_references(
    path: Path, name: str, photo: Path | None = None, material: Material | None = None
) -> References:
    """Collect the reference data that lies with a material or map set, or in it.

    Args:
        path: its file or folder.
        name: of it.
        photo: file shown in place of the one in the folder.
        material: the material itself; None of a map set.

    Raises:
        MatcapError: the photograph is none that matcap reads.
    """
    folder = path if path.is_dir() else path.parent
    file = photo or find_photograph(path, name) or reported_photograph(folder)
    example = material.part(Example) if material else None
    setup = material.setup if material and example else None
    return References(
        browser_picture(file, setup) if file else None,
        doubt_picture(example.exemplar) if example else None,
        read_verdict(folder),
    )


def find_photograph(path: Path, name: str) -> Path | None:
    """The photograph in a capture's folder: of the material's name, or called photo."""
    folder = path if path.is_dir() else path.parent
    for suffix in _PHOTOGRAPHS:
        for file in (folder / f"{name}{suffix}", folder / f"photo{suffix}"):
            if file.is_file():
                return file
    return None


def reported_photograph(folder: Path) -> Path | None:
    """The photograph that a capture's report says it was made from, where it still is."""
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        file = Path(report["photograph"]["path"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return file if file.is_file() else None


def read_verdict(folder: Path) -> tuple[str, str] | None:
    """The verdict that a capture left in its folder; None where there is none to be read."""
    try:
        verdict = json.loads((folder / "report.json").read_text(encoding="utf-8"))["verdict"]
        return str(verdict["rating"]), str(verdict["sentence"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def browser_picture(file: Path, setup: FlashSetup | None = None) -> EncodedPicture:
    """A photograph as JPEG of at most 1024 pixels a side.

    Args:
        file: the photograph.
        setup: how it was taken: it is shown as its plane would look from straight above.

    Raises:
        MatcapError: the file is not a photograph that matcap reads.
    """
    from PIL import Image

    from matcap.files.srgb import srgb_picture
    from matcap.photo.load import load_photo

    photo = load_photo(file, long_side=_LONG_SIDE, noise=False)
    linear = photo.pixels
    if setup is not None:
        from matcap.flash.rectify import rectify

        linear = rectify(photo, setup, linear.shape[1])[0].movedim(0, -1).numpy()
    # A portrait stands, but beside maps that lie as it was read.
    if photo.turned if setup is None else setup.turned:
        linear = np.ascontiguousarray(np.rot90(linear, -1))
    pixels = srgb_picture(linear)
    stored = io.BytesIO()
    Image.fromarray(np.rint(pixels * 255.0).astype(np.uint8)).save(stored, "JPEG", quality=88)
    return EncodedPicture(stored.getvalue(), "image/jpeg")


def doubt_picture(exemplar: Exemplar) -> EncodedPicture:
    """A colour over the piece, the more opaque the less its maps are trusted."""
    from PIL import Image

    step = max(1, max(exemplar.size) // _LONG_SIDE)
    trusted = exemplar.confidence.mean(axis=0)[::step, ::step]
    shade = np.empty((*trusted.shape, 4), np.uint8)
    shade[..., :3] = _DOUBT
    shade[..., 3] = np.rint(_OPAQUE * (1.0 - trusted))
    stored = io.BytesIO()
    Image.fromarray(shade).save(stored, "PNG")
    return EncodedPicture(stored.getvalue(), "image/png")
