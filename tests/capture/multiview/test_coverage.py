"""What is said of a set before it is captured."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from simulated.files import write_jpeg
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, hold, take_several

from matcap.capture.inspection import coverage, coverage_of_files
from matcap.capture.multiview.mosaic import Mosaic
from matcap.capture.multiview.set_report import SetReport
from matcap.capture.registration.register import register
from matcap.cli.main import main
from matcap.errors import MatcapError
from matcap.files.names import are_a_series
from matcap.flash.coarse.fit import fit_coarse
from matcap.photo.checks import CHECKS, Rating


@pytest.fixture(scope="module")
def looked(held, foreign):
    _, photos = held
    return register([photos[0], foreign, *photos[1:]], fit_coarse(photos[0]).setup)


def test_cameras_are_found_and_a_foreign_photograph_is_named(held, looked):
    cameras, photos = held
    assert [view.photo.name for view in looked.views] == [photo.name for photo in photos]
    assert [one.name for one in looked.left_out] == ["leather_9"] and looked.left_out[0].why
    for view, camera in zip(looked.views[1:], cameras[1:], strict=True):
        apart = np.linalg.norm(view.camera.place - camera.place)
        assert apart < 0.03 * np.linalg.norm(camera.place)


def test_missing_sides_of_light_are_named(looked):
    values = coverage(looked)
    assert values["belong"].value == {"used": 3, "left_out": ["leather_9"]}
    assert "leather_9 does not belong" in values["belong"].says
    # The second camera is moved to the right, the third to the top.
    assert values["lit_from"].says == "No photograph lights the sample from the left or bottom."
    assert values["lit_from"].rating is Rating.NOT_JUDGED
    assert values["baseline"].rating is Rating.GOOD and values["overlap"].rating is Rating.GOOD
    assert 1.05 < values["union"].value < 2.0 and "--union" in values["union"].says
    assert json.loads(json.dumps(values.document()))["rating"] == "doubtful"


def test_a_steep_camera_is_named(looked):
    first, last = looked.views[0], looked.views[-1]
    turn = cv2.Rodrigues(np.array([math.radians(60.0), 0.0, 0.0]))[0]
    steep = replace(last, camera=replace(last.camera, turn=turn))
    places = coverage(replace(looked, views=(first, steep)))["baseline"]
    assert f"{last.photo.name} was taken 60 degrees off vertical." in places.says
    assert places.rating is Rating.DOUBTFUL


def test_deviations_of_cameras_are_findings(looked):
    found = coverage(looked)["cameras"]
    assert set(found.value) == {"plaster_1", "plaster_2"} and min(found.value.values()) > 0.0

    def at(deviation):
        views = tuple(replace(view, position_deviation=deviation) for view in looked.views)
        return coverage(replace(looked, views=views))

    sure, unsure = at(0.001), at(0.004)
    assert sure["cameras"].rating is Rating.GOOD and "0.10 %" in sure["cameras"].says
    assert unsure["cameras"].rating is Rating.NOT_JUDGED and "0.40 %" in unsure["cameras"].says


def test_a_report_warns_of_uncertain_cameras(looked):
    def result(deviation):
        views = tuple(
            replace(v, position_deviation=deviation if n else 0.0)
            for n, v in enumerate(looked.views)
        )
        return SetReport(views, (), (), (), (0.0,) * 4, (0.0,) * 3, Mosaic.own((64, 48))).warning()

    assert result(0.0015) is None
    assert "0.3 % of their distance (plaster_1, plaster_2)" in result(0.003)


def test_a_report_states_that_the_first_photograph_is_kept(looked):
    told = (0.1,) * 3, (), (), (0.0,) * 4, (0.0,) * 3, Mosaic.own((64, 48)), None, (0.2, 0.1)
    result = SetReport(looked.views, *told)
    assert "plaster_0 alone does" in result.warning() and "0.200 and 0.100" in result.warning()
    assert result.document()["first_alone"]


def test_a_report_names_a_photograph_with_a_shadow(looked):
    own = Mosaic.own((64, 48))
    result = SetReport(looked.views, (0.1,) * 3, (), (), (0.0,) * 4, (0.0,) * 3, own)
    assert "darker" not in (replace(result, shaded=(0.0, 0.09, math.nan)).warning() or "")
    said = replace(result, shaded=(0.0, 0.25, math.nan)).warning()
    assert said.startswith("25 % of plaster_1 is far darker than the others show")


def test_directions_are_of_the_upright_picture(looked):
    views = tuple(replace(v, photo=replace(v.photo, turned=True)) for v in looked.views)
    values = coverage(replace(looked, views=views))
    # Turned back clockwise what lay at the right lies at the bottom, and the top at the right.
    assert values["lit_from"].says == "No photograph lights the sample from the left or top."


def test_two_photographs_from_one_place_are_named(looked):
    again = replace(looked.views[1], photo=replace(looked.views[1].photo, name="again"))
    values = coverage(replace(looked, views=(*looked.views, again)))
    assert values["baseline"].says == "plaster_1 and again were taken from nearly the same place."
    assert values["baseline"].value < CHECKS["baseline"].limits[0]


def test_one_photograph_alone_has_failed(looked):
    values = coverage(replace(looked, views=looked.views[:1]))
    assert values.rating is Rating.FAILED
    none = "No other photograph shows the same sample as plaster_0."
    assert values["belong"].says.startswith(none)


def test_one_photograph_is_no_set(tmp_path):
    with pytest.raises(MatcapError, match="two or more"):
        coverage_of_files([tmp_path / "a.jpg"])


def test_numbered_names_are_a_series():
    assert are_a_series(["oak_1", "oak_2", "Oak_3"]) and are_a_series(["oak 00", "oak 01"])
    for stems in (["oak_1"], ["oak_1", "elm_2"], ["IMG_0001", "IMG_0002"], ["oak_2", "oak_3"],
                  ["oak_1", "oak_3"], ["oak1", "oak2"], ["2024_1", "2024_2"], []):  # fmt: skip
        assert not are_a_series(stems)


@pytest.mark.usefixtures("one_coarse_fit")
def test_inspect_checks_sets(tmp_path, capsys):
    phone, hand = PhoneCamera(width=320, height=240, supersampling=1), Hand()
    cameras = hold(phone, hand, 2, 5)
    paths = []
    for number, one in enumerate(take_several(piece("plaster", 15), phone, cameras, hand, 5)):
        paths.append(str(tmp_path / f"plaster_{number}.jpg"))
        write_jpeg(tmp_path / f"plaster_{number}.jpg", one, number)
    assert main(["inspect", "--json", *paths]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["together"]["belong"]["value"]["used"] == 2 and len(values["photographs"]) == 2
    assert main(["inspect", "--no-together", *paths]) == 0
    assert "together" not in capsys.readouterr().out
    assert main(["inspect", "--together", *paths]) == 0
    assert "2 photographs together" in capsys.readouterr().out
