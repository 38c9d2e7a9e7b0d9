"""The example scenes and the named ones can be rendered, and show something."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from relight_samples import bumpy

from matcap.relight.named import PRESETS, preset
from matcap.relight.render import relight
from matcap.relight.scene import Film
from matcap.relight.scenefile import read_scene

FILES = sorted((Path(__file__).parents[2] / "examples" / "scenes").glob("*.toml"))
SCENES = [(path.stem, read_scene(path)) for path in FILES] + [(n, preset(n)) for n in PRESETS]


@pytest.mark.parametrize(("name", "scene"), SCENES, ids=[name for name, _ in SCENES])
def test_it_shows_something_well_exposed(name, scene):
    film = scene.film or Film()
    small = replace(scene, film=replace(film, width=24, height=18))
    picture = relight(bumpy(64, 64), small) * film.gain
    assert np.isfinite(picture).all()
    shown = picture[picture.max(axis=-1) > 0]
    assert len(shown) > 50
    assert 0.05 < np.median(shown) < 1.0


def test_there_are_examples():
    assert len(FILES) >= 5
