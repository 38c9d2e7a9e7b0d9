"""The sweep of relighting and exporting, a call or two a domain, each within what is documented.

`sweep.py` draws ten million; docs/notes/stability.md has what it found.
"""

import numpy as np
import pytest
from stable.domains import DOMAINS
from stable.edges.swept import Swept, sweep

EDGES = DOMAINS["relighting"]

# Largest error of the few draws below; what it is relative to, EDGES has.
WITHIN = {
    "lobes, roughness from 0.03": 1e-3,
    "lobes, roughness below 0.03": 0.3,
    "albedo tables, n.v from 0.01": 6e-3,
    "albedo tables, n.v below 0.01": 0.1,
    "compensation, white furnace": 0.03,
    "point and directional lights": 2e-6,
    "area lights, diffuse": 1e-4,
    "environments": 0.02,
    "filtering, squares of 2^k texels": 1e-6,
    "filtering, footprints 1e-30 to 1e30": 1e-6,
    "parallax: the ray ends on the surface": 0.15,
    "parallax: ridges passed through": 1.1,
    "shadows": 1.0,
    "whole scenes of any numbers": 0.0,
    "metallic workflow": 5e-3,  # halved twelve times: finer than 8 bits
    "textures written and read": 1.01,
    "targets and presets": 0.0,
}
# Calls, where not four.
CALLS = {"whole scenes of any numbers": 30, "targets and presets": 1, "environments": 2}


def test_every_domain_is_here_and_their_shares_are_the_whole():
    assert list(WITHIN) == list(EDGES)
    assert sum(edge.share for edge in EDGES.values()) >= 1.0


@pytest.mark.parametrize("name", EDGES)
def test_nothing_is_not_finite_and_errors_are_as_documented(name):
    generator = np.random.default_rng(7)
    found = Swept()
    for _ in range(CALLS.get(name, 4)):
        found += sweep(lambda _: EDGES[name].domain(generator), 1, 0)
    assert found.broken == 0, found.where
    assert found.worst <= WITHIN[name], found.where
    assert found.draws > 0
