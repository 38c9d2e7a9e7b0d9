"""docs/guide/paper.md: its tables are those of docs/bench/paper.csv."""

from dataclasses import replace

from guide import ROOT

from matcap.lab.bench.paper_tables import paper_page
from matcap.lab.experiment.results import read

PAGE = (ROOT / "docs/guide/paper.md").read_text(encoding="utf-8")


def test_the_page_has_the_tables_that_bench_paper_makes_of_the_measured_rows():
    rows = read(ROOT / "docs/bench/paper.csv")
    assert {row.subject for row in rows} == {"leather", "granite", "asphalt10"}
    assert len(rows) == 3 * 8
    timeless = [
        replace(row, values={name: x for name, x in row.values.items() if name != "seconds"})
        for row in rows
    ]
    tables = [line for line in paper_page(timeless, "").splitlines() if line.startswith("|")]
    assert len(tables) > 12
    assert [line for line in tables if line not in PAGE.splitlines()] == []
