"""Render the example photographs and, on request, the true maps they were made from.

python examples/make_examples.py --out examples/photos [--only leather] [--truth DIR]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap_lab.simulate.files import write_dng, write_jpeg
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import EXAMPLES


def main() -> None:
    """Parse the command line and write what it asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the photographs")
    parser.add_argument("--only", choices=list(EXAMPLES), action="append", help="these alone")
    parser.add_argument("--truth", type=Path, help="folder for the true map sets")
    chosen = parser.parse_args()
    camera = PhoneCamera()
    for name in chosen.only or EXAMPLES:
        example = EXAMPLES[name]
        shot = example.take(camera)
        write_dng(chosen.out / f"{name}.dng", shot, example.seed, example.shading)
        write_jpeg(chosen.out / f"{name}.jpg", shot, example.seed)
        if chosen.truth:
            info = MapSetInfo(name, seed=example.seed, provenance={"setup": vars(shot.setup)})
            write_mapset(example.truth(camera), chosen.truth / name, info)
        print(name)


if __name__ == "__main__":
    main()
