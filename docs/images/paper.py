"""The paper's figures as one sheet, by its generator: endless, seeds, interpolation, space.

python docs/images/paper.py [FILE]     takes about four minutes of a core

From the top: a strip of 4096 x 512 texels of a leather's decoder; four seeds of it; its blend with
a granite at shares 0, 1/3, 2/3 and 1; eight materials that the prior draws, without a photograph.
Each is lit from the upper left. Simulated photographs; none was left out after it was seen.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from repeats import PANEL, Picture, lit

from matcap.brdf.maps import MapSet
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.field.material import Material
from matcap.space.between import blend
from matcap.space.prior.store import load_prior
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import photograph, subjects

FILE = Path(__file__).parent / "paper.jpg"
_STRIP, _AREA = (4096, 512), (512, 384)  # texels
_PANELS = 4  # panels in a row


def main(file: Path = FILE) -> None:
    """Make the sheet."""
    leather, granite = (captured(name) for name in ("leather", "granite"))
    panels = [shown(leather.maps(*_AREA, seed=seed)) for seed in range(1, 5)]
    for share in np.linspace(0.0, 1.0, _PANELS):
        panels.append(shown(blend(leather, granite, float(share)).maps(*_AREA, seed=1)))
    space = load_prior(None)
    panels += [shown(space.draw(seed).maps(*_AREA, seed=1)) for seed in range(8)]
    rows = [np.hstack(panels[at : at + _PANELS]) for at in range(0, len(panels), _PANELS)]
    width = _PANELS * PANEL[0]
    strip = shown(leather.maps(*_STRIP, seed=1), (width, width * _STRIP[1] // _STRIP[0]))
    Image.fromarray(np.vstack([strip, *rows])).save(file, "JPEG", quality=70, optimize=True)
    print(file, file.stat().st_size // 1024, "KB")


def captured(name: str) -> Material:
    """The decoder of a simulated photograph."""
    with tempfile.TemporaryDirectory() as folder:
        path, _ = photograph(subjects([name])[0], PhoneCamera(), Path(folder))
        return capture_file(path, CaptureSettings(generator="decoder", detail=1024)).material


def shown(maps: MapSet, size: tuple[int, int] = PANEL) -> Picture:
    """Maps lit so that all panels are about as bright."""
    return lit(maps, 0.35 / float((maps.diffuse + maps.specular).mean()), size)


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
