"""Run a command in its own process and measure wall time, processor time and peak memory.

    python clocked.py COMMAND...

Prints them as JSON and exits with the command's code. A small process between the bench and the
command, without matcap or torch: a child's peak memory starts at its parent's.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time


def main(command: list[str]) -> int:
    """Run the command; returns its exit code."""
    began = time.monotonic()
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=sys.stderr, check=False)
    clock = time.monotonic() - began
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    peak = used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    cost = {"clock": clock, "processor": used.ru_utime + used.ru_stime, "megabytes": peak}
    sys.stdout.write(json.dumps(cost) + "\n")
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
