"""Run a command in its own process and measure wall time, processor time and peak memory.

    python clocked.py COMMAND...

Prints them as JSON and ends with the command's exit code. It stands between the bench and the
command and imports nothing, for a child's memory begins with what its parent holds.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time


def main(command: list[str]) -> int:
    """Run; the command's exit code."""
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
