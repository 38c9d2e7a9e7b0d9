"""`matcap-lab bench highlight`: the coarse fit's highlights, flash offset and tilt.

Real photographs: the highlight is measured alike in photograph and re-rendering
(flash/highlight.py). Simulated ones: errors against the known offset and tilt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.verdict.judge import visible
from matcap.errors import MatcapError
from matcap.files.picture import write_picture
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, plane_points, unproject
from matcap.flash.highlight import CELLS, find_highlight, light_of
from matcap.flash.light import FlashLight
from matcap.flash.render import uniform_radiance
from matcap.photo.exif import phone_fov
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.materials import random_material
from matcap_lab.simulate.materials.kinds import random_kind
from matcap_lab.simulate.photograph import PhoneCamera, as_photo
from matcap_lab.simulate.specimen import Specimen

ABOUT = (
    "Of real photographs: apart: distance of the highlight's centre in photograph and re-rendering "
    "(plane units); width and contrast: the re-rendering's over the photograph's; kept: 1 if these "
    "are within 0.03, 20 % and 20 %. Of simulated ones: errors of the flash's offset (plane units) "
    "and tilt (degrees); visible: 1 if the highlight is clearly visible."
)
# Tolerances of a reproduced highlight: centre in plane units, relative width and contrast.
CENTRE, WIDTH, CONTRAST = 0.03, 0.2, 0.2
# Simulated photographs: degrees across, plane units of offset, degrees of tilt.
_FOV, _OFFSET, _TILT = (40.0, 90.0), (0.02, 0.2), 15.0
_CAMERA = (512, 384)


Seen = tuple[Photo, FlashSetup | None]  # and its true setup where it was simulated


def highlight_experiment(
    photographs: Sequence[Path], count: int, seed: int, out: Path, *, has_fov: bool = True
) -> Experiment[Seen, CoarseFit]:
    """The coarse fit of real photographs that have a highlight, and of `count` simulated ones.

    Pictures of photograph and re-rendering side by side go to `out`. Without `has_fov` simulated
    files do not state their field of view.
    """

    def real(path: Path) -> Seen:
        photo = load_photo(path, noise=False)
        if not visible(find_highlight(light_of(photo.pixels))):
            raise MatcapError("it shows no clear highlight")
        return photo, None

    def pair(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
        photo, truth = seen
        if truth is None:
            again = rerendered(fit, photo).astype(np.float32)
            small = cv2.resize(photo.pixels, again.shape[1::-1], interpolation=cv2.INTER_AREA)
            both = np.concatenate([np.minimum(small, 1.0), again], axis=1)
            write_picture(both, out / f"{Path(photo.name).stem}.png")
        return {}

    return Experiment(
        "highlight",
        {path.name: partial(real, path) for path in photographs}
        | simulated(count, seed, has_fov=has_fov),
        {"coarse fit": Configuration(lambda seen, _seed: fit_coarse(seen[0]))},
        (kept, placed, pair),
        settings=(has_fov, [(str(path), path.stat().st_mtime_ns) for path in photographs]),
    )


def kept(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
    """Parameters of the highlight in a real photograph and in its re-rendering."""
    photo, truth = seen
    names = ("apart", "width", "contrast", "kept")
    if truth is not None:
        return dict.fromkeys(names, math.nan)
    highlight = find_highlight(light_of(photo.pixels))
    again = find_highlight(rerendered(fit, photo).mean(axis=2))
    assert highlight is not None
    if again is None:
        return dict(zip(names, (math.inf, 0.0, 0.0, 0.0), strict=True))
    distance = math.dist(highlight.centre, again.centre)
    width, contrast = again.width / highlight.width, again.contrast / highlight.contrast
    near = distance <= CENTRE and abs(width - 1.0) <= WIDTH and abs(contrast - 1.0) <= CONTRAST
    return dict(zip(names, (distance, width, contrast, float(near)), strict=True))


def placed(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
    """Errors of flash offset and tilt on a simulated photograph."""
    photo, truth = seen
    if truth is None:
        return dict.fromkeys(("offset", "tilt", "visible"), math.nan)
    return {
        "offset": math.dist(fit.setup.offset[:2], truth.offset[:2]),
        "tilt": math.degrees(math.dist(fit.setup.tilt, truth.tilt)),
        "visible": float(visible(find_highlight(light_of(photo.pixels)))),
    }


def rerendered(fit: CoarseFit, photo: Photo) -> NDArray[np.float64]:
    """(h, CELLS, 3) the fit re-rendered by the photograph's camera, clipped at its clip level."""
    rows, columns = photo.pixels.shape[:2]
    height = max(8, round(CELLS * rows / columns))
    image = plane_points(0, 0, CELLS, height, (CELLS, height), dtype=torch.float64)[:2]
    light = FlashLight.of(fit.setup, unproject(image, fit.setup))
    picture = uniform_radiance(fit, light)[0].permute(1, 2, 0).numpy()
    return np.minimum(fit.tone.developed(picture), 1.0)


def simulated(count: int, seed: int, *, has_fov: bool = True) -> dict[str, Callable[[], Seen]]:
    """`count` RAW photographs by name, of random field of view, flash offset and tilt."""
    rng = np.random.default_rng(seed)
    width, height = _CAMERA
    subjects: dict[str, Callable[[], Seen]] = {}
    for number in range(count):
        material = random_kind(rng) if number % 3 else random_material(rng)
        half = math.tan(math.radians(rng.uniform(*_FOV)) / 2.0)
        aside, towards = rng.uniform(*_OFFSET), rng.uniform(0.0, 2.0 * math.pi)
        lean, about = math.radians(rng.uniform(0.0, _TILT)), rng.uniform(0.0, 2.0 * math.pi)
        setup = FlashSetup(
            offset=(aside * math.cos(towards), aside * math.sin(towards), 0.0),
            tilt=(lean * math.cos(about), lean * math.sin(about)),
            vignetting=0.02,
        )
        focal_length = round(18.0 / half)
        camera = PhoneCamera(width, height, focal_length, supersampling=1, blur=0.5)
        name = f"{getattr(material, 'kind', 'pattern')} {seed}/{number}"
        specimen = Specimen(name, material.realise, number, setup)
        subjects[name] = partial(_taken, specimen, camera, has_fov)
    return subjects


def _taken(specimen: Specimen, camera: PhoneCamera, has_fov: bool) -> Seen:
    shot = specimen.take(camera)
    photo = as_photo(shot, specimen.seed, f"{specimen.seed}")
    if not has_fov:
        photo = replace(photo, fov=phone_fov(*photo.original_size), fov_source="assumed")
    return photo, shot.setup
