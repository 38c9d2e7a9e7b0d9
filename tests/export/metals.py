"""Small map sets of metals: bare, rusted, painted and worn, anodised; and what is none."""

import torch
from simulated.materials import realise

from matcap.brdf.cook_torrance import METAL_F0
from matcap.brdf.maps import MapSet

DIELECTRIC = 0.04
SIDE = 32


def colour(*channels):
    return torch.tensor([float(one) for one in channels])[:, None, None]


def metallic(base, share, roughness, height, dielectric=DIELECTRIC):
    """diffuse = base (1 - m), F0 = f (1 - m) + base m."""
    base = base.expand(3, *share.shape[1:])
    f0 = dielectric * (1.0 - share) + base * share
    texel = 2.0 / share.shape[-1]
    return MapSet(base * (1.0 - share), f0, roughness, height, texel, periodic=True)


def field(seed, octaves=(2, 4, 8), side=SIDE):
    """(1, side, side) smooth, periodic, mean 0 and deviation 1."""
    draw = torch.Generator().manual_seed(seed)
    at = torch.arange(side) / side * 2.0 * torch.pi
    y, x = torch.meshgrid(at, at, indexing="ij")
    total = torch.zeros(side, side)
    for octave in octaves:
        for _ in range(6):
            a, b = (int(n) for n in torch.randint(-octave, octave + 1, (2,), generator=draw))
            phase = float(torch.rand((), generator=draw)) * 6.3
            total += torch.cos(a * x + b * y + phase) / octave
    return ((total - total.mean()) / total.std())[None]


def metals():
    """{name: maps} of SIDE x SIDE texels, all but the last of a metallic model."""
    relief, patches = 0.01 * field(1), torch.sigmoid(6.0 * field(2))
    ones = torch.ones_like(relief)
    steel, rust = colour(*METAL_F0["steel"]), colour(0.20, 0.07, 0.03)
    paint, speckle = colour(0.45, 0.05, 0.04), 0.2 * field(3, (8, 16))
    worn = torch.sigmoid(12.0 * (field(2) - 0.8))
    found = {
        name: metallic(colour(*f0), ones, 0.3 + 0.02 * field(4), relief)
        for name, f0 in METAL_F0.items()
    }
    found["rust beside steel"] = metallic(
        patches * steel + (1.0 - patches) * rust * (1.0 + speckle),
        patches, 0.75 - 0.4 * patches, relief,
    )  # fmt: skip
    found["worn paint"] = metallic(
        worn * steel + (1.0 - worn) * paint, worn, 0.45 - 0.15 * worn, relief, 0.05
    )
    found["blue anodised"] = metallic(colour(0.06, 0.16, 0.55), ones, 0.35 * ones, relief)
    found["leather"] = realise("leather", SIDE, SIDE, 1, 2.0 / SIDE).map(lambda map_: map_.float())
    return found
