"""What synth makes of a material does not change: files that were written before are the measure.

Beside this file, in `before/`: a small material with random weights, the maps of a corner of its
field, and digests of what `matcap synth` wrote of it. Bits are the same on one machine and build
(docs/guide/how-it-works.md): the digests are compared where processor and PyTorch are those they
were written with; the corner is compared everywhere.

Written again, after a change that is meant to change bits, by
`python tests/synth/test_same_bits.py`.
"""

import hashlib
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch

from matcap.cli.main import main
from matcap.field.field import Field
from matcap.field.material import Material
from matcap.files.exr import read_exr

BEFORE = Path(__file__).with_name("before")
MATERIAL = BEFORE / "before.matcap"
SEED, CORNER = 7, (-12, -9, 24, 16)
CALLS = {
    "size": ["--size", "96x64", "-j", "1"],
    "region": ["--region", "-40,-24,96,64", "-j", "2", "--normal", "dx"],
    "tile": ["--size", "64x48", "--tile", "both"],
}


def where():
    """What bits depend on."""
    return [torch.__version__, torch.backends.cpu.get_cpu_capability()]


def corner():
    """(6, H, W) maps around the field's origin, two blocks and more."""
    return Field(Material.load(MATERIAL), SEED).read(*CORNER).stacked().numpy()


def digests(words, folder):
    """Of every map that synth writes, and of what the document says."""
    assert main(["synth", str(MATERIAL), "--seed", str(SEED), *words, "-q", "-o", str(folder)]) == 0
    found = {}
    for file in sorted([*folder.glob("*.exr"), *folder.glob("*.json")]):
        if file.suffix == ".json":
            result = json.loads(file.read_text())
            content = json.dumps(result | {"matcap": "any"}).encode()
        else:
            content = read_exr(file).pixels.tobytes()
        found[file.name] = hashlib.sha256(content).hexdigest()
    return found


def test_a_corner_of_the_field_has_stayed():
    np.testing.assert_allclose(corner(), np.load(BEFORE / "corner.npy"), atol=1e-4)


@pytest.mark.parametrize("call", CALLS)
def test_synth_writes_the_bits_it_wrote_before(call, tmp_path):
    before = json.loads((BEFORE / "digests.json").read_text())
    if before["where"] != where():
        pytest.skip(f"written with {before['where']}")
    assert digests(CALLS[call], tmp_path / "maps") == before["digests"][call]


def test_a_material_is_written_as_it_was_read(tmp_path):
    again = tmp_path / "again.matcap"
    Material.load(MATERIAL).save(again)
    assert again.read_bytes() == MATERIAL.read_bytes()


if __name__ == "__main__":
    np.save(BEFORE / "corner.npy", corner())
    with tempfile.TemporaryDirectory() as scratch:
        made = {name: digests(words, Path(scratch) / name) for name, words in CALLS.items()}
    text = json.dumps({"where": where(), "digests": made}, indent=2)
    (BEFORE / "digests.json").write_text(text + "\n")
