"""`matcap bench`: what the command hands to the measurement and prints of it."""

import pytest

from matcap.errors import MatcapError
from matcap.lab.bench.quality import Score


@pytest.fixture
def measured(monkeypatch):
    """Replaces the measurement; gives the list of its calls."""
    calls = []

    def run(capture, out, **options):
        calls.append((capture, out, options))
        options["tell"]("halfway")
        return [Score("granite", "capture", 1.5, 2.5, 60.0)]

    monkeypatch.setattr("matcap.lab.bench.quality.run_quality", run)
    return calls


def test_the_table_is_printed_and_written(matcap, measured, tmp_path):
    said = matcap(
        "bench", "quality", "-o", tmp_path / "q", "--material", "granite", "--detail", 256,
        "--preset", "draft",
    )  # fmt: skip
    assert said.code == 0
    assert said.err == "halfway\n"
    assert "| granite | capture | 1.50 | 2.50 | 2.00 | 60 |" in said.out
    assert sorted(f.name for f in (tmp_path / "q").iterdir()) == ["quality.csv", "quality.md"]
    ((capture, out, options),) = measured
    assert out == tmp_path / "q"
    assert options["materials"] == ["granite"]
    assert options["settings"].detail == 256
    assert capture.keywords["preset"] == "draft"
    assert capture.keywords["detail"] == 256


def test_a_failed_capture_is_3(matcap, monkeypatch, tmp_path):
    def fail(*args, **kwargs):
        raise MatcapError("plenoptic is not installed", remedy='pip install "matcap[bench]"')

    monkeypatch.setattr("matcap.lab.bench.quality.run_quality", fail)
    said = matcap("bench", "quality", "-o", tmp_path / "q")
    assert (said.code, said.out) == (3, "")
    assert said.err == 'matcap: plenoptic is not installed; pip install "matcap[bench]".\n'
    assert list(tmp_path.iterdir()) == []
