"""The photographed piece of a photograph's file, and the field that rearranges it, to be measured.

Without the decoder: coarse fit, inverse network, refinement, index.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import FoundPiece, piece_maps
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import PRESETS, CaptureSettings, Method
from matcap.example.example import Example
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.baselines import Fixed


@dataclass(frozen=True)
class Rearranged:
    """An example as an endless field.

    Attributes:
        example: what is rearranged.
        setup: camera and flash it goes with.
    """

    example: Example
    setup: FlashSetup

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.example.exemplar.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0) -> MapSet:
        """One realisation."""
        stacked = torch.from_numpy(self.example.maps(seed, Rectangle(0, 0, width, height), None))
        return MapSet.from_stacked(stacked, self.texel_size)


def found_piece(path: Path, detail: int) -> tuple[FoundPiece, FlashSetup]:
    """The exemplar of a photograph's file, and its setup as fitted."""
    settings = CaptureSettings(steps=0, detail=detail, aligned=True)  # no decoder is asked for
    method = Method(adapted=PRESETS["standard"].adapted)
    photo = read_photograph(path, settings, method)
    result = capture_photo(photo, settings, method=method)
    assert result.found is not None
    return result.found, result.material.setup


def photographed_piece(path: Path, detail: int) -> Fixed:
    """The maps themselves."""
    found, setup = found_piece(path, detail)
    return Fixed(piece_maps(found.exemplar), setup)


def rearranged_piece(path: Path, detail: int) -> Rearranged:
    """More of them."""
    found, setup = found_piece(path, detail)
    return Rearranged(found.example, setup)
