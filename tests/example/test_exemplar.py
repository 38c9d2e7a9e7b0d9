"""An exemplar survives its file, and a broken file is told from a whole one."""

from dataclasses import fields, replace

import numpy as np
import pytest
from exemplars import reread

from matcap.example.exemplar import Exemplar


def an_exemplar(width=70, height=40, seed=1):
    random = np.random.default_rng(seed)
    shares = random.random((9, height, width), np.float32)
    return Exemplar(
        diffuse=shares[:3],
        specular=shares[3:4],
        roughness=shares[4:5],
        height=0.02 * random.standard_normal((1, height, width)).astype(np.float32) + 3.0,
        confidence=shares[5:],
        texel_size=2 / 1024,
    )


def same(first, second):
    return all(
        np.array_equal(getattr(first, one.name), getattr(second, one.name))
        for one in fields(Exemplar)
    )


def test_a_file_gives_back_what_rounding_says():
    exemplar = an_exemplar()
    assert same(reread(exemplar), exemplar.rounded())
    assert same(exemplar.rounded().rounded(), exemplar.rounded())
    assert not same(exemplar, exemplar.rounded())


def test_rounding_is_finer_than_what_is_seen():
    exemplar = an_exemplar()
    rounded = exemplar.rounded()
    spread = float(np.ptp(exemplar.height))
    assert np.abs(rounded.height - exemplar.height).max() <= spread / 2**15
    # To the nearest, which no direction is preferred by.
    unit = 2.0 ** (exemplar.stored()[1]["height_unit"] - 1)
    off = (rounded.height.astype(np.float64) - exemplar.height) / unit
    assert np.abs(off).max() <= 0.55 and abs(off.mean()) < 0.05
    assert np.abs(rounded.diffuse - exemplar.diffuse).max() <= 2**-11
    assert np.abs(rounded.confidence - exemplar.confidence).max() <= 0.5 / 15 + 1e-6


@pytest.mark.parametrize("height", [0.0, -7.5, 1e4])
def test_a_flat_exemplar_stays_flat(height):
    flat = replace(an_exemplar(), height=np.full((1, 40, 70), height, np.float32))
    assert np.ptp(reread(flat).height) == 0.0
    assert reread(flat).height[0, 0, 0] == pytest.approx(height, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("diffuse", np.zeros((3, 40, 71), np.float32)),
        ("diffuse", np.zeros((3, 40, 70), np.float64)),
        ("roughness", np.full((1, 40, 70), 1.5, np.float32)),
        ("height", np.full((1, 40, 70), np.nan, np.float32)),
        ("confidence", np.full((4, 40, 70), -0.1, np.float32)),
    ],
)
def test_maps_out_of_shape_or_range_are_refused(name, values):
    with pytest.raises(ValueError, match=name):
        replace(an_exemplar(), **{name: values})


def test_damaged_files_are_refused():
    tensors, about = an_exemplar().stored()

    def read(tensors=tensors, **other):
        return Exemplar.read({**about, **other}, tensors.__getitem__)

    with pytest.raises(ValueError, match="exemplar of"):
        read(size=[10**6, 10**6])
    with pytest.raises(ValueError, match="bytes"):
        read(size=[70, 41])
    with pytest.raises(ValueError, match="bytes"):
        read(size=[70, 39])
    with pytest.raises(ValueError, match="unpacked|bytes"):
        read(tensors | {"diffuse": tensors["diffuse"][:-9]})
    with pytest.raises(ValueError, match="unpacked"):
        read(tensors | {"height": np.zeros(50, np.uint8)})
    with pytest.raises(ValueError, match="heights"):
        read(height_unit=500)
    with pytest.raises(KeyError):
        read({"diffuse": tensors["diffuse"]})


def test_planes_are_contiguous_however_they_are_given():
    """The field's kernel reads each plane by its address."""
    exemplar = an_exemplar()
    interleaved = {
        one.name: np.asfortranarray(getattr(exemplar, one.name))
        for one in fields(Exemplar)
        if one.name != "texel_size"
    }
    stored = replace(exemplar, **interleaved)
    assert same(stored, exemplar)
    assert all(getattr(stored, name).flags.c_contiguous for name in interleaved)
