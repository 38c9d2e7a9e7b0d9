"""Large buffers are used again, in threads too: fresh pages can cost as much as the computing."""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PROGRAM = """
import resource, sys
from matcap.space.decoder import DecoderConfig
from matcap.space.patch import Rectangle
from matcap.field.single import single_threaded
from matcap.files.memory import keep_memory
from matcap.space.tuned import TunedDecoder

if sys.argv[1] == "kept":
    keep_memory()
sys.path.insert(0, sys.argv[2])
from materials import a_material

config = DecoderConfig(2, (32, 32, 32, 32, 32), (1, 1))
source = a_material(config=config).part(TunedDecoder).source(0)
faults = []
with single_threaded(1) as pool:
    for _ in range(6):
        pool.submit(source.maps, Rectangle(0, 0, 512, 256)).result()
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
print(faults[-1] - faults[2])
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings are glibc's")
def test_the_buffers_of_one_block_serve_the_next():
    fetched = {}
    for name in ("as it comes", "kept"):
        command = [sys.executable, "-c", PROGRAM, name, str(TESTS)]
        run = subprocess.run(command, capture_output=True, check=True, text=True)
        fetched[name] = int(run.stdout)
    assert fetched["kept"] < 0.1 * fetched["as it comes"]
