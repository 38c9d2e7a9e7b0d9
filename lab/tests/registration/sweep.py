"""Errors of registered cameras on many simulated sets, of which a third are hard.

    python lab/tests/registration/sweep.py --sets 300
    python lab/tests/registration/sweep.py --sets 24 --aligned 512

Prints a table of sets, with means by difficulty; a killed run continues from its CSV. Exits with 4
if a camera is off by more than 2 % of its distance, or a photograph of another sample was used.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sets import sets_experiment

from matcap.errors import ExitCode
from matcap_lab.experiment.results import table
from matcap_lab.experiment.runner import run


def main(arguments: Sequence[str]) -> int:
    """Sweep; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=300, help="how many, every third one hard")
    parser.add_argument("--seed", type=int, default=0, help="of the first set")
    parser.add_argument("-o", "--out", type=Path, default=Path("bench/registration"))
    aligned = "texels across of a capture that has moved photographs first"
    parser.add_argument("--aligned", type=int, metavar="TEXELS", help=aligned)
    asked = parser.parse_args(arguments)
    experiment = sets_experiment(asked.sets, asked.seed, asked.aligned)
    asked.out.mkdir(parents=True, exist_ok=True)
    rows = run(
        experiment, asked.out / "registration.csv", lambda line: print(line, file=sys.stderr)
    )
    print(table(rows, " ".join(["python", *sys.argv])))
    wrong = any(row.number("wrong") for row in rows)
    return ExitCode.SOME_FAILED if wrong else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
