"""The field read in blocks beside the network that was tuned, on a whole torus.

    python tests/torus.py [material.matcap]...

prints the largest difference of any map; without a file, of two small random materials.
"""

import sys
from dataclasses import replace
from pathlib import Path

import torch
from materials import SMALL, a_material

from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.plane import BLOCK, BLOCK_HEIGHT, Rectangle
from matcap.space.decoder import DEPTH, maps_from_raw
from matcap.space.freeze import Drawing
from matcap.space.random_field import Patch, random_field
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave

WAVES = (Wave(1 / 16.7, 0.003), Wave(0.002, 1 / 9.3))
PERIOD = (BLOCK + 64, BLOCK_HEIGHT + 96)


def noisy(waves: tuple[Wave, ...] = (), drawing: Drawing | None = None) -> Material:
    """A material of random weights."""
    config = replace(SMALL, cells=3 if waves else 0)
    return a_material("test", config=config, waves=waves, drawing=drawing)


def both(material: Material) -> tuple[torch.Tensor, torch.Tensor]:
    """Stacked maps in blocks, and of the decoder that is trained.

    That has circular padding, batch normalisation, and no blocks.
    """
    found = Field(material, 5, PERIOD, generator="decoder").read(0, 0, *PERIOD).stacked()
    tuned = material.part(TunedDecoder)
    assert tuned is not None
    config = tuned.decoder.config
    field = random_field(
        Patch(5, Rectangle(0, 0, *PERIOD), period=PERIOD), config.noise_channels, tuned.waves,
        levels=DEPTH, cells=config.cells,
    )  # fmt: skip
    if tuned.drawing is not None:
        drawn = tuned.drawing.levels(5, Rectangle(0, 0, *PERIOD), PERIOD)
        field = replace(field, drawing=drawn)
    with torch.no_grad():
        raw = tuned.decoder(field, tuned.code, tuned.moments)[0]
    return found, maps_from_raw(raw, material.texel_size).stacked()


def main() -> None:
    named = {path: Material.load(Path(path)) for path in sys.argv[1:]}
    for name, material in (named or {"noise": noisy(), "waves": noisy(WAVES)}).items():
        found, expected = both(material)
        print(f"{name}: {float((found - expected).abs().max()):.1e} on {PERIOD[0]} x {PERIOD[1]}")


if __name__ == "__main__":
    main()
