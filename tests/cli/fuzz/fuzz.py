"""Feeds spoilt files to every reader but those of pictures (tests/photo/fuzz_readers.py).

    python tests/cli/fuzz/fuzz.py [COUNT] [SEED]

A MatcapError of one line or a good result comes out, and nothing else; COUNT and SEED make a
failing input again, which is kept in the current folder. test_fuzz.py runs a shorter form.
"""

import random
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from inputs import spoil, write_inputs

from matcap.batch.samples import BatchSettings, read_settings
from matcap.batch.work import FILE, is_done, read_record
from matcap.brdf.folder import read_mapset
from matcap.errors import MatcapError
from matcap.field.material import Material
from matcap.files.names import Note
from matcap.relight.foreign.read import read_foreign
from matcap.relight.scenefile import read_scene

# How often each kind comes up.
WEIGHTS = {"material": 5, "mapset": 2, "scene": 3, "settings": 3, "record": 1, "foreign": 3}


def _foreign(path: Path) -> None:
    texture = read_foreign(path.parent).texture
    for kind in ("diffuse", "specular", "roughness", "height", "slopes"):
        values = getattr(texture, kind)
        assert np.isfinite(values).all() and values.shape[1:] == texture.height.shape[1:], kind
        assert kind in ("height", "slopes") or 0.0 <= values.min() <= values.max() <= 1.0, kind


def _material(path: Path) -> None:
    material = Material.load(path)
    assert Path(material.name).name == material.name and len(material.name) < 200
    material.maps(16, 16)


def _settings(path: Path) -> None:
    settings = BatchSettings.of(read_settings(path))
    assert settings.capture.most_detail >= 64 and settings.outputs.room > 0


def _record(path: Path) -> None:
    path.rename(path.with_name(FILE))
    read_record(path.parent)
    is_done(path.parent, "i")


_READERS = {
    "material": _material, "mapset": read_mapset, "scene": read_scene, "settings": _settings,
    "record": _record, "foreign": _foreign,
}  # fmt: skip


def outcome(kind: str, path: Path) -> str:
    """Whether a file is "good" or "refused", or what else came out."""
    try:
        with warnings.catch_warnings():
            # What a user would see on the terminal is a fault, too.
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", Note)
            _READERS[kind](path)
    except MatcapError as error:
        said = str(error)
        plain = "\n" not in said and "Traceback" not in said and error.what
        return "refused" if plain else f"a sentence of several lines: {said!r}"
    except Exception:
        return traceback.format_exc(limit=-6)
    return "good"


def fuzz(folder: Path, count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """How many inputs were good and refused; and the faults, each with its input."""
    files = write_inputs(folder)
    data = {path: path.read_bytes() for paths in files.values() for path in paths}
    tally: Counter[str] = Counter()
    faults: list[str] = []
    for number in range(count):
        chance = random.Random(f"{seed} {number}")
        kind = chance.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
        source = chance.choice(files[kind])
        spoilt = spoil(data[source], kind, [data[path] for path in files[kind]], chance)
        with tempfile.TemporaryDirectory() as name:
            place = Path(name)
            if kind in ("mapset", "foreign"):  # its pictures stand beside it
                for other in source.parent.iterdir():
                    (place / other.name).symlink_to(other)
                (place / source.name).unlink()
            (place / source.name).write_bytes(spoilt)
            result = outcome(kind, place / source.name)
        tally[result if result in ("good", "refused") else "fault"] += 1
        if result not in ("good", "refused"):
            faults.append(f"{number} ({kind}): {result}")
            Path(f"fault_{seed}_{number}{source.suffix}").write_bytes(spoilt)
    return tally, faults


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        words = [int(word) for word in sys.argv[1:]]
        tally, faults = fuzz(Path(temporary), *(words + [20_000, 0][len(words) :]))
    print(*faults, dict(tally), sep="\n")
    sys.exit(bool(faults))
