"""Cameras and lights as they are drawn."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from matcap.capture.multiview.diagram import draw_set, set_report_lines
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.multiview.set_report import SetReport
from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.register import LeftOut, RegisteredView
from matcap.flash.geometry import FlashSetup

EXEMPLAR = np.full((48, 64, 3), 0.5, np.float32)
BLUE, GREEN, SPARK = (120, 200, 255), (140, 230, 150), (255, 214, 90)


def report(**changes):
    straight = PosedCamera.of(FlashSetup(fov=60.0))
    aside = replace(straight, place=straight.place + np.array([0.9, 0.0, 0.0]))
    cameras = {"oak_1.jpg": straight, "oak_2.jpg": aside}
    views = tuple(RegisteredView(SimpleNamespace(name=n), c) for n, c in cameras.items())
    result = SetReport(
        views, (0.02, 0.03), (0.04, 0.05), (LeftOut("cat.jpg", "it shows something else"),),
        (0.9, 0.3, 0.4, 0.8), (0.0, 0.2, 0.0), Mosaic.own((64, 48)),
    )  # fmt: skip
    return replace(result, **changes)


def middle(picture, colour):
    """Mean place (x, y) of a colour in the view from above."""
    codes = np.asarray(picture)[:, : picture.width // 3]
    rows, columns = np.nonzero((codes == colour).all(axis=2))
    assert rows.size
    return columns.mean(), rows.mean()


def test_cameras_stand_where_they_stood_and_flashes_beside_them():
    picture = draw_set(report(), EXEMPLAR, 1200)
    assert picture.size == (1200, 300)
    first, second = (middle(picture, colour) for colour in (BLUE, GREEN))
    assert second[0] > first[0] + 40
    # The flash lies upwards of its camera.
    assert middle(picture, SPARK)[1] < first[1] - 5


def test_what_each_told_is_told():
    said = [line for line, _ in set_report_lines(report())]
    assert said[0] == "1 oak_1.jpg: re-rendered within 2.0 %, predicted by the others within 4.0 %"
    assert said[2] == "left out: cat.jpg, it shows something else"
    assert said[3].startswith("measured, not predicted: diffuse 90 %, specular 30 %")


def test_an_interrupted_set_has_predicted_nothing():
    assert "predicted" not in next(set_report_lines(report(predicted=())))[0]


def test_a_photograph_without_flash_has_a_camera_and_no_spark():
    result = report()
    dark = replace(result, views=(result.views[0], replace(result.views[1], flash=False)))
    drawn = [np.asarray(draw_set(one, EXEMPLAR, 900)) for one in (result, dark)]
    sparks = [int((picture == SPARK).all(-1).sum()) for picture in drawn]
    assert 0 < sparks[1] < sparks[0]
    said = [line for line, _ in set_report_lines(dark)]
    assert said[1].endswith("without flash") and "predicted" not in said[1]
