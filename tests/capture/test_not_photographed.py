"""Beyond the frame of a tilted photograph is no material: not in fields, hatched in sheets."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from matcap.capture.exemplar.estimate import indexed
from matcap.capture.preview import Panel, hatched
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.plane import Rectangle

HEIGHT, WIDTH, FOREIGN = 144, 192, 0.99


@pytest.fixture(scope="module")
def kept():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return (x > 20 - 0.1 * y) & (y < HEIGHT - 12 + 0.05 * x)


@pytest.fixture(scope="module")
def exemplar(kept):
    random = np.random.default_rng(1)
    diffuse = random.uniform(0.2, 0.4, (3, HEIGHT, WIDTH)).astype(np.float32)
    diffuse[:, ~kept] = FOREIGN
    one = np.ones((1, HEIGHT, WIDTH), np.float32)
    height = 0.001 * random.standard_normal((1, HEIGHT, WIDTH)).astype(np.float32)
    confidence = np.ones((4, 1, 1), np.float32) * kept.astype(np.float32)
    return Exemplar(diffuse, 0.04 * one, 0.5 * one, height, confidence, 2 / WIDTH).rounded()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("variety", [0.0, 0.25, 1.0])
def test_a_field_shows_photographed_texels_alone(exemplar, kept, turned, variety):
    whole, example = indexed(exemplar, (), turned=turned, kept=kept)
    assert whole.size == ((HEIGHT, WIDTH) if turned else (WIDTH, HEIGHT))
    maps = example.varied(variety).maps(3, Rectangle(0, 0, 300, 300), None)
    assert maps[:3].max() < 0.5 and example.exemplar.size == whole.size
    assert np.prod(example.index.part.size) > 0.75 * kept.sum()
    assert example.repeating().diffuse.max() < 0.5
    tensors, about = example.stored()
    again = Example.read(json.loads(json.dumps(about)), tensors.__getitem__)
    assert again.index.part == example.index.part
    about["index"]["part"][2] = 10000
    with pytest.raises(ValueError, match="a part"):
        Example.read(about, tensors.__getitem__)


def test_a_mask_with_no_large_rectangle_is_indexed_whole(exemplar):
    middle = np.ones((HEIGHT, WIDTH), bool)
    middle[60:80, 80:110] = False
    whole, example = indexed(exemplar, (), turned=False, kept=middle)
    assert example.index.part is None


def test_a_sheet_hatches_what_is_hidden():
    white = Image.new("RGB", (40, 30), (255, 255, 255))
    where = np.zeros((30, 40), bool)
    where[:, :10] = True
    pixels = np.array(hatched(white, where))
    assert (pixels[:, 10:] == 255).all() and pixels[:, :10].max() < 200
    assert len(np.unique(pixels[:, :10, 0])) == 2


def test_a_panel_hatches_at_any_size_and_in_its_crop():
    hidden = np.zeros((600, 800), bool)
    hidden[:, :200] = True
    panel = Panel("photograph", np.ones((300, 400, 3), np.float32), hidden=hidden)
    shown = np.array(panel.resized((100, 75)))
    assert (shown[:, 26:] == 255).all() and shown[:, :24].max() < 200
    close = Panel("relit", panel.values, close=np.ones((256, 256, 3), np.float32), hidden=hidden)
    crop = np.array(close.crop())
    assert (crop[:, 129:] == 255).all() and crop[:, :127].max() < 200


def test_a_constant_map_is_a_number_and_is_not_hatched():
    flat = np.full((300, 400), 0.04, np.float32)
    panel = Panel("specular", flat, hidden=np.ones((600, 800), bool), number="0.04")
    empty = replace(panel, number=" ")
    for shown, blank in (
        (panel.resized((100, 75)), empty.resized((100, 75))),
        (panel.crop(), empty.crop()),
    ):
        assert len(np.unique(np.array(blank).reshape(-1, 3), axis=0)) == 1
        assert shown.size == blank.size and (np.array(shown) != np.array(blank)).any()


def test_an_enlarged_panel_stays_within_its_values():
    # A dark crystal in a white field: a cubic kernel alone goes below 0 beside it.
    light = np.full((40, 40, 3), 0.9, np.float32)
    light[18:22, 18:22] = 0.0
    for panel in (Panel("decoder", light), Panel("decoder", light[::4, ::4], close=light)):
        large = panel.enlarged(2.0)
        close = large.values if large.close is None else large.close
        assert close.min() >= 0.0 and close.max() <= np.float32(0.9)
        assert np.array(large.crop()).min() < 5  # the crystal is still black
