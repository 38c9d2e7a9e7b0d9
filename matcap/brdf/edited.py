"""Map sets that other programs saved or edited: colours, alpha, normals unlike the height."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import rec709_from
from matcap.files.exr import NamedChannels, read_exr
from matcap.files.names import name_fault, note

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet


# Maps that another program saved: with alpha, grey as three channels, or other primaries.

COLOURS = ("diffuse", "specular")  # maps whose three channels are a colour
_GREY = 2.0**-9  # largest difference of grey channels over the largest value: half-float rounding
_ALPHA = "A"

MapPixels = NDArray[np.float32]


def as_saved(stored: NamedChannels, channels: int, where: str) -> MapPixels:
    """(H, W, channels) of a map whose file has another number of channels.

    Drops alpha, with a note where it is not opaque; repeats one channel to three; reduces three
    equal ones to one. Anything else is returned as stored, for the caller to refuse.
    """
    pixels = without_alpha(stored)
    if pixels.shape[2] != stored.pixels.shape[2]:
        least = float(stored.pixels[..., stored.names.index(_ALPHA)].min())
        if least < 0.999:
            note(f"{where}: its transparency is not used")
    if pixels.shape[2] == 1 and channels == 3:
        return np.repeat(pixels, 3, axis=2)
    if pixels.shape[2] == 3 and channels == 1:
        spread = float(np.ptp(pixels, axis=2).max())
        if spread <= _GREY * float(np.abs(pixels).max()):
            return pixels[..., :1]
    return pixels


def without_alpha(stored: NamedChannels) -> MapPixels:
    """(H, W, C) without the alpha channel."""
    kept = [place for place, name in enumerate(stored.names) if name != _ALPHA]
    if not kept or len(kept) == len(stored.names):
        return stored.pixels
    return np.ascontiguousarray(stored.pixels[..., kept])


def in_rec709(colours: MapPixels, primaries: tuple[float, ...] | None, where: str) -> MapPixels:
    """(H, W, 3) linear colours, converted from the primaries that the file states.

    Raises:
        MatcapError: the primaries are degenerate.
    """
    try:
        matrix = None if primaries is None else rec709_from(primaries)
    except ValueError as error:
        raise MatcapError.at(
            where, f"its chromaticities span no colour space ({error})", "save it in Rec.709"
        ) from error
    if matrix is None:
        return colours
    note(f"{where}: colours converted from the file's primaries to Rec.709")
    return np.maximum(colours @ matrix.T.astype(np.float32), np.float32(0.0))


# Visibility of the seam of repeating maps: the step across the border over steps inside.

_LINES = 0.9  # quantile of the lines inside


def seam_ratio(maps: MapSet) -> float:
    """Ratio of the step across the wrap to the steps inside, mean over maps, of the worse axis.

    A step is the mean absolute difference of two adjacent lines of texels. The wrap is compared
    with the 0.9 quantile of the lines inside: threads and planks have edges, and the wrap may fall
    on one. About 1 or less without a seam, 1 for constant maps; up to 1.15 is invisible, since
    single lines of a texture scatter by as much.
    """
    each = (maps.diffuse, maps.specular, maps.roughness, maps.height)
    return max(sum(_ratio(one, axis) for one in each) / len(each) for axis in (-1, -2))


def _ratio(channels: Tensor, axis: int) -> float:
    """Step across the border over the step between lines inside, of one map (C, H, W)."""
    if channels.shape[axis] < 3:
        return 1.0
    values, other = channels.detach(), -3 - axis
    # One channel at a time: no copy as large as a whole map.
    across = sum(one.diff(dim=axis).abs_().mean(dim=other).double() for one in values)
    inside = float(across.quantile(_LINES)) / len(values)
    wrap = float((values.select(axis, 0) - values.select(axis, -1)).abs().mean())
    least = 1e-6 * float(values.abs().max())  # rounding
    return (wrap + least) / (inside + least) if least > 0.0 else 1.0


# Normal maps of a map set that were edited, so that they disagree with the height.
#
# matcap derives normals from the height. If the file differs a note says so; `--normals file` reads
# it instead.

_TEXELS = 1_000_000  # number of texels compared, in evenly spaced rows
_OFF = math.cos(math.radians(2.0))  # angle of an edit; rounding to half float is far less
_SHARE = 1e-3  # share of differing texels above which a map counts as edited
_STEEPEST = 0.02  # least z of a unit normal: 89 degrees, whose slope half floats still hold
_ANSWER = (
    "it is not read: normals are derived from the height; relight and export use it with "
    "--normals file"
)
_WITHOUT = "correct the file, or leave out --normals file"


def note_other_normals(maps: MapSet, document: dict[str, Any], folder: Path) -> None:
    """Note if the normal file disagrees with the height, or cannot be read."""
    name, channels = _stated(document)
    if name_fault(name) or not (folder / name).is_file():
        return
    try:
        stored = read_exr(folder / name, size=maps.size, channels=channels)
    except (MatcapError, TypeError, ValueError) as error:
        what = error.what if isinstance(error, MatcapError) else "its channels are unknown"
        note(f"{folder / name}: {what}; {_ANSWER}")
        return
    share = _differing(without_alpha(stored), maps, down=document.get("normal") == "dx")
    if share > _SHARE:
        differs = f"differs from the height at {100.0 * share:.1f} % of its texels"
        note(f"{folder / name}: {differs}; {_ANSWER}")


def painted_normals(document: dict[str, Any], folder: Path, size: tuple[int, int]) -> Tensor:
    """(3, H, W) unit normals of the file, +Y up.

    Args:
        size: (width, height) of the maps, in texels.

    Raises:
        MatcapError: no such file, another size, or normals that do not face upwards.
    """
    import torch

    name, _ = _stated(document)
    if name_fault(name):
        raise MatcapError.at(folder, "the map set names no file of normals", _WITHOUT)
    where = str(folder / name)
    pixels = without_alpha(read_exr(folder / name, size=size))
    if pixels.shape[2] != 3:
        raise MatcapError.at(where, f"has {pixels.shape[2]} channels instead of 3", _WITHOUT)
    length = np.linalg.norm(pixels, axis=-1, keepdims=True)
    unit = pixels / np.maximum(length, np.float32(1e-9))
    turned = int((unit[..., 2] < _STEEPEST).sum())
    if turned:
        raise MatcapError.at(where, f"the normals of {turned} texels do not face upwards", _WITHOUT)
    if document.get("normal") == "dx":
        unit = unit * np.array([1.0, -1.0, 1.0], np.float32)
    return torch.from_numpy(np.ascontiguousarray(unit.transpose(2, 0, 1), np.float32))


def _stated(document: dict[str, Any]) -> tuple[Any, Any]:
    """Name of the file of normals in a document, and its channels; None where not stated."""
    about = document["maps"].get("normal")
    about = about if isinstance(about, dict) else {}
    return about.get("file"), about.get("channels")


def _differing(pixels: np.ndarray[Any, Any], maps: MapSet, *, down: bool) -> float:
    """Share of inner texels whose normal differs from the height's by more than 2 degrees.

    Border texels may have been computed from neighbours outside of the maps.
    """
    from matcap.brdf.maps import normals_of_rows

    width, height = maps.size
    if pixels.shape[2] != 3 or min(width, height) < 3:
        return 0.0 if pixels.shape[2] == 3 else 1.0
    step = max(1, width * height // _TEXELS)
    off = texels = 0
    for row in range(1, height - 1, step):
        meant = normals_of_rows(
            maps.height, maps.texel_size, slice(row, row + 1), periodic=maps.periodic
        )
        unit = pixels[row] * np.array([1.0, -1.0 if down else 1.0, 1.0], np.float32)
        cosine = (meant[:, 0].movedim(0, -1).numpy() * unit).sum(axis=-1)
        cosine /= np.maximum(np.linalg.norm(unit, axis=-1), 1e-9)
        off += int((cosine[1:-1] < _OFF).sum())
        texels += width - 2
    return off / texels


# Validation of height maps.

# Plane units. Squares of the slopes of such heights do not overflow single precision.
TALLEST = 1e6


def check_heights(height: NDArray[np.floating], where: str = "") -> None:
    """Refuse heights above TALLEST, in plane units; NaN and infinity are checked elsewhere.

    Raises:
        MatcapError: naming `where`.
    """
    most = float(np.abs(height).max(initial=0.0))
    if TALLEST < most < float("inf"):
        raise MatcapError.at(
            where,
            f"its height reaches {most:.2g} plane units, which no surface does",
            "make the material again",
        )
