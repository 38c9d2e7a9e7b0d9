"""Glossy materials by one photograph, a bracket, an HDR gain map and a float file, and the truth.

python docs/images/light.py FOLDER sheet.jpg [SETS MATERIAL ...]     docs/images/light.jpg (crackle)

The photographs are simulated, as a phone develops them: one JPEG; the same and another four stops
darker, the camera turned by half a degree; one whose base is toned locally, with an HDR gain map
(ISO 21496-1); the light itself. Printed for each material: NSD of the captured maps, and their
highlight contrast over the true one. The sheet shows the last. SETS is a folder of map sets.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap_lab.bench.floors import exemplar_maps
from matcap_lab.measures.evaluator import (
    EvaluationSettings,
    Evaluator,
    highlight_contrast,
    mirrored_scene,
)
from matcap_lab.measures.nsd import SqueezeNetStyle
from matcap_lab.simulate.files import PHONE, write_gain_map_jpeg, write_jpeg
from matcap_lab.simulate.photograph import PhoneCamera, Shot, sensor_noise, take
from matcap_lab.simulate.specimen import Specimen, phone_cone, subjects

CAMERA = PhoneCamera(1024, 768)
DETAIL, SIDE = 512, 256
MARGIN = 400  # texels of the plane around the picture, for a camera that is tilted
STOPS = 4


def main(folder: Path, sheet: Path, sets: Path | None, names: Sequence[str]) -> None:
    """Simulate, capture and relight."""
    folder.mkdir(parents=True, exist_ok=True)
    for subject in subjects(names, sets):
        subject = replace(subject, setup=phone_cone(subject.setup, subject.name))
        rows, numbers = relit(subject, written(folder, subject))
        shown = (f"{kind} {nsd:.2f} {contrast:.2f}" for kind, (nsd, contrast) in numbers.items())
        print(f"{subject.name}, NSD and contrast:", ", ".join(shown), flush=True)
    sheets = [np.concatenate([lit[k].permute(1, 2, 0).numpy() for lit in rows], 1) for k in (0, 2)]
    codes = np.rint(np.concatenate(sheets) * 255.0).astype(np.uint8)
    Image.fromarray(codes).save(sheet, "JPEG", quality=85)


def written(folder: Path, subject: Specimen) -> dict[str, list[Path]]:
    """Write a specimen's photographs; their paths by kind."""
    width, height = (2 * side + MARGIN for side in (CAMERA.width, CAMERA.height))
    whole = subject.realise(width, height, 1.0 / CAMERA.width)

    def realise(w: int, h: int, _texel: float) -> MapSet:
        return whole.crop((width - w) // 2, (height - h) // 2, w, h)  # the same piece by any camera

    tilt = subject.setup.tilt
    turned = replace(subject.setup, tilt=(tilt[0] + math.radians(0.5), tilt[1]))
    shot, other = (take(realise, CAMERA, setup) for setup in (subject.setup, turned))
    darker = shot.setup.intensity[0] / other.setup.intensity[0] * 2.0**-STOPS
    light, dark, mapped = (folder / f"{subject.name}{k}.jpg" for k in ("", "_dark", "_gain"))
    write_jpeg(light, shot, subject.seed, PHONE)
    dark_shot = Shot(other.linear * darker, other.setup, CAMERA, exposure=2.0**-STOPS)
    write_jpeg(dark, dark_shot, subject.seed + 1, PHONE)
    noisy = sensor_noise(shot.linear, CAMERA, subject.seed).clip(0.0).astype(np.float32)
    write_gain_map_jpeg(mapped, shot, subject.seed)
    floats = folder / f"{subject.name}.tif"
    tifffile.imwrite(floats, noisy, photometric="rgb")
    return {"one": [light], "bracket": [light, dark], "gain map": [mapped], "float": [floats]}


def relit(
    subject: Specimen, photographs: dict[str, list[Path]]
) -> tuple[list[Tensor], dict[str, tuple[float, float]]]:
    """Pictures of captures and of the truth under mirrored lights; NSD and contrast over true."""
    setup = subject.take(CAMERA).setup
    compared = EvaluationSettings(DETAIL, SIDE, CAMERA, truths=2, finer=2)
    evaluator = Evaluator(subject, setup, compared, {"NSD": SqueezeNetStyle()})
    scene = mirrored_scene(setup)
    true = [math.log(highlight_contrast(piece, scene)) for piece in evaluator.truths]
    rows, numbers = [], {}
    for label, paths in photographs.items():
        settings = CaptureSettings(preset="instant", detail=DETAIL, fov=CAMERA.fov)
        captured = exemplar_maps(capture_file(paths[0], settings, others=paths[1:]))
        middle, intensity = evaluator.middle(captured.maps), captured.setup.intensity
        contrast = math.log(highlight_contrast(middle, scene)) - float(np.mean(true))
        numbers[label] = evaluator.style_ratio_of(captured.maps, intensity), math.exp(contrast)
        rows.append(evaluator.relit(middle, intensity, scene))
    rows.append(evaluator.relit(evaluator.truths[0], setup.intensity, scene))
    return rows, numbers


if __name__ == "__main__":
    given: Sequence[str] = sys.argv[1:]
    sets = Path(given[2]) if len(given) > 2 else None
    main(Path(given[0]), Path(given[1]), sets, given[3:] or ["crackle"])
