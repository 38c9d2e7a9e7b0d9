"""Whether anything ever comes out NaN or infinite, and how right float32 is.

    python tests/lab/stability/sweep.py --quick

Draws the reflectance from every corner of its domain, values and gradients, captures photographs
that go wrong in every way known, sets of them and parts, and compares relighting and exporting with
float64 and closed forms. Prints two tables; exits with 4 when anything in them was not finite.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

from stable.edges import table
from stable.sweeps import QUICK, StabilitySettings, markdown, run_stability, unstable

from matcap.errors import ExitCode


def main(arguments: Sequence[str]) -> int:
    """Sweep; the exit code."""
    asked = _parser().parse_args(arguments)
    usual = QUICK if asked.quick else StabilitySettings()
    given = {name: value for name, value in vars(asked).items() if value is not None}
    del given["quick"]
    settings = replace(usual, **given)

    def tell(line: str) -> None:
        print(line, file=sys.stderr)

    captured = settings.draws or settings.photographs or settings.sets
    rows = run_stability(settings, tell) if captured else []
    edges = table.run_edges(settings.relighting, settings.seed, tell) if settings.relighting else {}
    print(markdown(rows, " ".join(["python", *sys.argv])))
    if edges:
        print(table.edges_markdown(edges))
    failed = unstable(rows) + table.failures(edges)
    return ExitCode.SOME_FAILED if failed else ExitCode.DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few draws, each photograph once")
    parser.add_argument("--draws", type=int, help="of the reflectance, of each case; 100,000")
    parser.add_argument("--photographs", type=int, help="hard ones to capture; 500")
    parser.add_argument("--sets", type=int, help="of photographs, and parts of them; 300")
    parser.add_argument("--relighting", type=int, help="draws of relighting and exporting; 10^7")
    parser.add_argument("--seed", type=int, help="of all draws")
    return parser


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
