"""Small packs of photographs, as fixtures too."""

import pytest
import torch
from small import coarse, small_light

from matcap.statistics.lattice import Wave
from matcap_lab.train.corpus import Entry, Pack, srgb_bytes


def jpeg(seed: int) -> bytes:
    """A small photograph."""
    import cv2

    return cv2.imencode(".jpg", srgb_bytes(small_light(seed).clip(0.0, 1.0)))[1].tobytes()


def entry(name: str, seed: int, *, simulated: bool = False) -> Entry:
    """A photograph of the pack."""
    return Entry(
        name=f"{name}_{seed}.jpg",
        material=name,
        simulated=simulated,
        jpeg=jpeg(seed),
        coarse=coarse(),
        contrast=torch.tensor([0.2, 0.3, 0.25]),
        waves=(Wave(0.05, 0.01),) if simulated else (),
        tilt=(0.1, -0.2) if simulated else None,
    )


@pytest.fixture(scope="session")
def pack() -> Pack:
    """Thirteen real materials, so that one is left to train on, and a simulated one."""
    real = [entry(f"m{index}", index) for index in range(13)]
    return Pack((*real, entry("simulated", 99, simulated=True)))


@pytest.fixture(scope="session")
def small_pack() -> Pack:
    """Two real materials, which are held out, and two simulated ones to train on."""
    simulated = [entry(f"simulated{index}", index, simulated=True) for index in (20, 21)]
    return Pack((entry("m0", 0), entry("m1", 1), *simulated))
