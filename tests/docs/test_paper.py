"""docs/guide/paper.md: its tables are those of docs/bench/paper.csv."""

from guide import ROOT

from matcap.lab.bench.paper_tables import paper_page
from matcap.lab.experiment.results import read

PAGE = (ROOT / "docs/guide/paper.md").read_text(encoding="utf-8")


def test_the_page_has_the_tables_that_bench_paper_makes_of_the_measured_rows():
    rows = read(ROOT / "docs/bench/paper.csv")
    experiments = {row.experiment for row in rows}
    assert experiments == {"paper", "interpolation", "generation"}
    captured = [row for row in rows if row.experiment == "paper"]
    assert {row.subject for row in captured} == {"leather", "granite", "asphalt10"}
    assert len(captured) == 3 * 8 + 1  # the paper's own system, of leather
    tables = [line for line in paper_page(rows, "").splitlines() if line.startswith("|")]
    assert len(tables) > 22
    assert [line for line in tables if line not in PAGE.splitlines()] == []
