"""Random rectangles, block orders and worker counts against one reading of the whole.

python tests/synth/draws.py 200
"""

import random
import sys
from dataclasses import replace
from pathlib import Path

import torch

from matcap.field.field import read_source
from matcap.field.plane import Grid, Rectangle, block_parts
from matcap.field.source import inner
from matcap.files.threads import single_threaded

PLACES = (0, 2**31, 2**40)


def wholes(material, seed=11):
    """A rectangle of some blocks near each place, and its maps."""
    source = replace(material.generator.source(seed), grid=Grid(128, 64))
    for place in PLACES:
        x, y = min(place - 61, 2**40 - 400), max(-place + 23, -(2**40))
        area = Rectangle(x, y, 400, 190)
        yield source, area, read_source(source, area, 1).stacked()


def draw(source, area, whole, generator):
    """One draw: the part of the whole that a random rectangle is, read in a random manner."""
    width, height = generator.randint(1, area.width), generator.randint(1, area.height)
    x, y = generator.randint(0, area.width - width), generator.randint(0, area.height - height)
    part = Rectangle(area.x + x, area.y + y, width, height)
    expected = whole[:, y : y + height, x : x + width]
    if generator.random() < 0.5:
        found = read_source(source, part, generator.randint(1, 4)).stacked()
    else:
        found = shuffled(source, part, generator)
    return torch.equal(found, expected)


def shuffled(source, part, generator):
    """The maps of a rectangle whose blocks come in any order."""
    stacked = torch.empty(6, part.height, part.width)
    pieces = list(block_parts(part, source.grid, source.period))
    generator.shuffle(pieces)
    with single_threaded(generator.randint(1, 3)) as pool:
        maps = list(pool.map(source.maps, [piece.block for piece in pieces]))
    for piece, one in zip(pieces, maps, strict=True):
        stacked[(..., *piece.target)] = inner(one)[(..., *piece.source)]
    return stacked


def run(material, count, seed=0):
    """How many of so many draws are the same bits as the whole."""
    generator = random.Random(seed)
    places = list(wholes(material))
    return sum(draw(*places[index % len(places)], generator) for index in range(count))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from materials import a_material

    total = int(sys.argv[1])
    print(f"{run(a_material(), total)} of {total} draws are bit-identical")
