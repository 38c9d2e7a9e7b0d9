"""Decoders are kept quiet, the program is not, and stderr comes back."""

import subprocess
import sys

import numpy as np
from dng_files import mosaic, write_dng

SCRIPT = """
import logging, os, sys, threading
from matcap.files.quiet import quiet_decoders

inside, done = threading.Event(), threading.Event()
def other():
    with quiet_decoders():
        inside.set(); done.wait()

thread = threading.Thread(target=other)
with quiet_decoders():
    thread.start(); inside.wait()
    os.write(2, b"from C\\n")
    logging.getLogger("tifffile").warning("from a decoder's log")
    print("progress", file=sys.stderr)
os.write(2, b"from C, with another thread still inside\\n")
done.set(); thread.join()
os.write(2, b"after\\n")
print("and again", file=sys.stderr)
"""


def test_only_decoders_are_silenced():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert done.stderr == "progress\nafter\nand again\n"


def test_process_without_stderr():
    script = "import os; os.close(2)\nfrom matcap.files.quiet import quiet_decoders\n"
    script += "with quiet_decoders(): print('read')"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "read\n"


def test_a_cut_raw_prints_nothing(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((96, 128, 3), 0.4)))
    path.write_bytes(path.read_bytes()[:9000])
    script = "import sys, matcap.photo.load as load\nfrom matcap.errors import MatcapError\n"
    script += "try: load.load_photo(sys.argv[1])\nexcept MatcapError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True)
    assert done.stderr == "" and "truncated or damaged" in done.stdout
