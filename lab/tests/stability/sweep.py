"""Whether anything ever comes out NaN or infinite, and how right float32 is.

    python lab/tests/stability/sweep.py [--quick] [--seed N] [-o FOLDER] [GROUP=DRAWS ...]

Draws the reflectance from every corner of its domain, values and gradients, captures photographs
that go wrong in every way known, sets of them and parts, and compares relighting and exporting with
float64 and closed forms: the groups of stable/domains.py, all of them unless some are named. A
killed run goes on from its CSV. Prints tables; exits with 4 when anything was not finite.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).parents[3] / "tests"))  # arrays, loop_calls

from stable.domains import DOMAINS, QUICK, USUAL, failures, stability_experiment

from matcap.errors import ExitCode
from matcap_lab.experiment.results import table
from matcap_lab.experiment.runner import run


def main(arguments: Sequence[str]) -> int:
    """Sweep; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few draws, each photograph once")
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument("-o", "--out", type=Path, default=Path("bench/stability"))
    parser.add_argument("groups", nargs="*", metavar="GROUP=DRAWS", help=f"of {', '.join(DOMAINS)}")
    asked = parser.parse_args(arguments)
    usual = QUICK if asked.quick else USUAL
    parted = [group.partition("=") for group in asked.groups or DOMAINS]
    asked.out.mkdir(parents=True, exist_ok=True)
    failed = 0
    for group, _, draws in parted:
        experiment = stability_experiment(group, int(draws or usual[group]), asked.seed)
        rows = run(
            experiment, asked.out / f"{group}.csv", lambda line: print(line, file=sys.stderr)
        )
        print(table(rows, " ".join(["python", *sys.argv])))
        failed += failures(group, rows)
    return ExitCode.SOME_FAILED if failed else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
