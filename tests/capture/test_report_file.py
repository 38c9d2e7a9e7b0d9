"""Reports of format 1 are read as format 2."""

import json

import pytest

from matcap.capture.report import read_report

OLD = {
    "format": "matcap report",
    "verdict": {
        "rating": "usable",
        "causes": [{"name": "tilt", "says": "tilted", "remedy": "hold it parallel"}],
        "checks": {"light": {"says": "brighter"}},
    },
    "several": {"photographs": [{"name": "a"}]},
}
NEW = {
    "format": "matcap report",
    "version": 2,
    "verdict": {
        "rating": "usable",
        "causes": [{"name": "tilt", "message": "tilted", "remedy": "hold it parallel"}],
        "checks": {"light": {"message": "brighter"}},
    },
    "multi_view": {"photographs": [{"name": "a"}]},
}


@pytest.mark.parametrize("document", [OLD, NEW], ids=["format 1", "format 2"])
def test_reports_of_both_formats_are_read_as_the_second(tmp_path, document):
    file = tmp_path / "report.json"
    file.write_text(json.dumps(document))
    assert read_report(file) == NEW


@pytest.mark.parametrize(
    ("document", "read"),
    [
        ({"format": "another"}, None),
        ({"format": "matcap report", "version": 3}, None),
        ({"format": "matcap report", "version": "2"}, None),
        (
            {"format": "matcap report", "verdict": {"checks": [], "causes": "none"}, "error": 3},
            {
                "format": "matcap report",
                "version": 2,
                "verdict": {"checks": [], "causes": "none"},
                "error": 3,
            },
        ),
    ],
)
def test_other_and_damaged_reports_are_refused_or_left_as_they_are(tmp_path, document, read):
    file = tmp_path / "report.json"
    file.write_text(json.dumps(document))
    assert read_report(file) == read
