"""What the photograph does not show, drawn by example from where it does (Aittala et al. 2015).

Where the picture is burnt out nothing is seen of albedo or gloss. The endless field rearranges
confident places alone; a piece of it is laid into the hole, with a soft edge.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from matcap.model.example.example import Example
from matcap.model.exemplar import Exemplar, Floats
from matcap.model.plane import Rectangle

_LEAST = 2e-4  # share of the texels, below which nothing is worth filling
_REACH = 9  # texels around a hole that its glare has touched
_EDGE = 6.0  # texels: deviation of the soft edge


def fill(exemplar: Exemplar, example: Example) -> Exemplar:
    """The exemplar with diffuse, F0 and roughness drawn by example where nothing was seen.

    Relief is kept: it has no means of its own, and a piece's edges would be steps.

    Args:
        exemplar: as found; its confidence is 0 where nothing was seen, and stays so.
        example: the same, indexed.
    """
    unseen = (exemplar.confidence[0] <= 0.0).astype(np.uint8)
    if unseen.mean() < _LEAST:
        return exemplar
    wide = cv2.dilate(unseen, np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8))
    share = cv2.GaussianBlur(wide.astype(np.float32), (0, 0), _EDGE)
    share = np.maximum(share, unseen)[None]
    width, height = exemplar.size
    piece = example.maps(0, Rectangle(0, 0, width, height), None)

    def mixed(map_: Floats, drawn: Floats) -> Floats:
        return np.asarray(map_ + share * (drawn - map_), np.float32).clip(0.0, 1.0)

    return replace(
        exemplar,
        diffuse=mixed(exemplar.diffuse, piece[:3]),
        specular=mixed(exemplar.specular, piece[3:4]),
        roughness=mixed(exemplar.roughness, piece[4:5]),
    )
