"""How right cameras are found, on many simulated sets of which a third are hard.

    python tests/flash/registration/sweep.py --sets 300 --kept sets.jsonl
    python tests/flash/registration/sweep.py --sets 24 --aligned 512 --kept aligned.jsonl

Prints two tables, of cameras and of sets, and on the way each set: how far its worst camera is
off, and what was left out though it belongs. Ctrl-C ends with tables of what was done; sets that
the file `--kept` holds are not done again. Exits with 4 where a camera is off by more than 2 % of
its distance, or a foreign photograph was taken in, without being said.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sets import (
    SetOutcome,
    failed,
    keep,
    kept,
    kinds,
    make_set,
    outcome_of,
    outcome_of_capture,
    table,
    table_of_sets,
    verdict,
)

from matcap.errors import ExitCode, MatcapError


def main(arguments: Sequence[str]) -> int:
    """Sweep; the exit code."""
    asked = _parser().parse_args(arguments)
    done = kept(asked.kept, asked.width) if asked.kept else {}
    outcomes: list[SetOutcome] = []
    try:
        for number, kind in enumerate(kinds(asked.sets), asked.seed):
            if asked.only not in (None, kind):
                continue
            key = f"{number} {kind or 'easy'}"
            if key not in done:
                done[key] = _outcome(number, kind, asked.width, asked.aligned)
                if asked.kept:
                    keep(asked.kept, asked.width, key, done[key])
            outcomes.append(done[key])
    except KeyboardInterrupt:
        print(f"Ended after {len(outcomes)} sets.")
    print(table(outcomes), table_of_sets(outcomes), sep="\n\n")
    wrong = any(verdict(one) == "wrong" for one in outcomes)
    return ExitCode.SOME_FAILED if wrong else ExitCode.DONE


def _outcome(seed: int, kind: str | None, width: int, detail: int | None) -> SetOutcome:
    made = make_set(seed, hard=kind, width=width)
    try:
        found = outcome_of(made) if detail is None else outcome_of_capture(made, detail)
    except MatcapError as error:
        found = failed(made, error)
    worst, doubt = max(found.errors, default=0.0), max(found.doubts, default=0.0)
    said = f"{found.name} ({found.kind}): {worst:.2%} off, {doubt:.2%} said"
    said += f", {found.taken_in} foreign"
    print("; ".join([said, *found.kept_out]), file=sys.stderr, flush=True)
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=300, help="how many, every third one hard")
    parser.add_argument("--width", type=int, default=800, help="pixels across")
    parser.add_argument("--seed", type=int, default=0, help="of the first set")
    parser.add_argument("--kept", type=Path, help="file of sets that are done, to go on from")
    parser.add_argument(
        "--aligned",
        type=int,
        metavar="TEXELS",
        help="judge cameras after a capture of so many texels across has moved photographs",
    )
    parser.add_argument("--only", help="sets that are hard this way")
    return parser


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
