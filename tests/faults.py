"""Puts deliberate faults into a copy of the package, and shows that the tests catch each.

    python tests/faults.py            all of them
    python tests/faults.py area plan  those whose names hold one of these words

A fault (fault_list.py) is one expression or statement of a function replaced (mutate.py); it is
caught when one of the tests named with it fails. First the tests must pass as they are.
test_faults.py runs a shorter form.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fault_list import FAULTS, Fault
from mutate import mutated

ROOT = Path(__file__).parents[1]


def copied(place: Path) -> None:
    """The repository as links, in a new folder."""
    for name in ("matcap", "tests", "docs"):
        shutil.copytree(
            ROOT / name, place / name, copy_function=os.symlink,
            ignore=shutil.ignore_patterns("__pycache__"),
        )  # fmt: skip
    shutil.copy(ROOT / "pyproject.toml", place)


def passes(tests: tuple[str, ...], place: Path) -> bool:
    """Whether tests pass in a copy.

    Raises:
        RuntimeError: there are none of these names, or they cannot be run.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(tests)}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 0


def caught(fault: Fault, place: Path) -> bool:
    """Whether the tests of a copy catch a fault.

    Raises:
        mutate.Gone: its place is not there once.
    """
    original, text = mutated(ROOT / "matcap", fault.where, fault.right, fault.wrong)
    file = place / original.relative_to(ROOT)
    file.unlink()
    file.write_text(text)
    compiled = [file.parent / one.name for one in _built(original)]
    for library in compiled:
        library.unlink()
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O2", "-fno-math-errno", "-ffp-contract=off",
             *map(str, file.parent.glob("*.c")), "-o", str(library), "-lm"],
            check=True,
        )  # fmt: skip
    try:
        return not passes(fault.command, place)
    finally:
        for one in (file, *compiled):
            one.unlink()
            one.symlink_to(ROOT / one.relative_to(place))


def _built(file: Path) -> list[Path]:
    """What was compiled from a file."""
    return [*file.parent.glob("*.so")] if file.suffix in (".c", ".h") else []


def main() -> None:
    words = sys.argv[1:]
    chosen = [f for f in FAULTS if not words or any(word in f.name for word in words)]
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "copy"
        place.mkdir()
        copied(place)
        for tests in sorted({fault.command for fault in chosen}):
            if not passes(tests, place):
                sys.exit(f"{' '.join(tests)} fails without any fault")
        for fault in chosen:
            began = time.monotonic()
            found = caught(fault, place)
            missed += [] if found else [fault.name]
            seconds = time.monotonic() - began
            print(
                f"{'caught' if found else 'MISSED':<8}{fault.name}  ({seconds:.0f} s)", flush=True
            )
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults caught.")
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
