"""Reports of format 1 are read as format 2."""

import json

import pytest

from matcap.capture.report import read_report

OLD = {
    "format": "matcap report",
    "error": {"piece": 0.1, "field": 0.6},
    "effort": {"preset": "draft", "places": 3},
    "verdict": {
        "rating": "usable",
        "causes": [{"name": "tilt", "says": "tilted", "remedy": "hold it parallel"}],
        "checks": {"piece": {"says": "differs"}, "light": {"says": "brighter"}},
    },
    "exemplar": {"slow": 0.01, "strengths": {"bands": [{"waves": [64, 32]}]}},
    "several": {
        "photographs": [{"likeness": 0.9, "place": [0, 0, 1], "doubt": 0.1, "predicted": None}],
        "left_out": [{"name": "a", "why": "blurred"}],
        "union": {"times": 1.5},
    },
}
NEW = {
    "format": "matcap report",
    "version": 2,
    "error": {"exemplar": 0.1, "field": 0.6},
    "effort": {"preset": "draft", "windows_per_step": 3},
    "verdict": {
        "rating": "usable",
        "causes": [{"name": "tilt", "message": "tilted", "remedy": "hold it parallel"}],
        "checks": {"exemplar": {"message": "differs"}, "light": {"message": "brighter"}},
    },
    "exemplar": {
        "low_frequency_residual": 0.01,
        "relief_spectrum": {"bands": [{"wavelengths": [64, 32]}]},
    },
    "multi_view": {
        "photographs": [
            {
                "correlation": 0.9,
                "position": [0, 0, 1],
                "position_deviation": 0.1,
                "leave_one_out_residual": None,
            }
        ],
        "left_out": [{"name": "a", "reason": "blurred"}],
        "mosaic": {"area_ratio": 1.5},
    },
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
