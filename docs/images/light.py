"""One glossy material by one photograph, a bracket and an HDR gain map, and its truth.

python docs/images/light.py FOLDER sheet.jpg [MATERIAL]     docs/images/light.jpg (crackle)

The photographs are simulated, as a phone develops them: one JPEG; the same and another four stops
darker, the camera turned by half a degree; one whose base is toned locally, with an HDR gain map
(ISO 21496-1). Printed: highlight contrast of the captured maps over the true one.
"""

from __future__ import annotations

import io
import math
import struct
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from matcap.lab.bench.methods import exemplar_maps
from matcap.lab.measures.lights import highlight_contrast, mirrored_scene, relight_all
from matcap.lab.simulate.photograph import PhoneCamera, Shot
from matcap.lab.simulate.specimen import subjects
from matcap.lab.simulate.write_jpeg import PHONE, write_jpeg
from numpy.typing import NDArray
from PIL import Image

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.files.color import srgb_picture

CAMERA = PhoneCamera(1024, 768)
DETAIL, SIDE = 512, 256
STOPS = 4
ISO = b"urn:iso:std:iso:ts:21496:-1\0"


def main(folder: Path, sheet: Path, name: str) -> None:
    """Simulate, capture and relight."""
    folder.mkdir(parents=True, exist_ok=True)
    (subject,) = subjects([name])
    shot = subject.take(CAMERA)
    tilt = subject.setup.tilt
    turned = replace(subject.setup, tilt=(tilt[0] + math.radians(0.5), tilt[1]))
    other = replace(subject, setup=turned).take(CAMERA)
    darker = shot.setup.intensity[0] / other.setup.intensity[0] * 2.0**-STOPS
    light, dark, mapped = (folder / f"{name}{kind}.jpg" for kind in ("", "_dark", "_gain"))
    write_jpeg(light, shot, subject.seed, PHONE)
    dark_shot = Shot(other.linear * darker, other.setup, CAMERA, exposure=2.0**-STOPS)
    write_jpeg(dark, dark_shot, subject.seed + 1, PHONE)
    write_gain_map(mapped, shot.linear.astype(np.float32))
    scene = mirrored_scene(shot.setup)
    width = SIDE * 2.0 / DETAIL
    pieces = [subject.pieces(subject.seed + 1 + k)(2 * SIDE, 2 * SIDE, width / 2 / SIDE)
              for k in range(2)]  # fmt: skip
    truth = float(np.mean([math.log(highlight_contrast(piece, scene)) for piece in pieces]))
    rows = []
    for label, paths in {"one": [light], "bracket": [light, dark], "gain map": [mapped]}.items():
        settings = CaptureSettings(detail=DETAIL, fov=CAMERA.fov)
        result = capture_file(paths[0], settings, others=paths[1:])
        maps = exemplar_maps(result)
        middle = centred(maps.maps)
        ratio = math.exp(math.log(highlight_contrast(middle, scene)) - truth)
        print(f"{label}: {ratio:.2f} {result.photo.headroom:.1f} {result.photo.notes}", flush=True)
        rows.append(relight_all(middle, maps.setup.intensity, scene, size=(SIDE, SIDE)))
    rows.append(relight_all(pieces[0], shot.setup.intensity, scene, size=(SIDE, SIDE)))
    shown = [np.concatenate([lit[k].permute(1, 2, 0).numpy() for lit in rows], 1) for k in (0, 2)]
    codes = np.rint(np.concatenate(shown) * 255.0).astype(np.uint8)
    Image.fromarray(codes).save(sheet, "JPEG", quality=85)


def centred(maps: MapSet) -> MapSet:
    """The central square of maps."""
    width, height = maps.size
    return maps.crop((width - SIDE) // 2, (height - SIDE) // 2, SIDE, SIDE)


def write_gain_map(path: Path, light: NDArray[np.float32]) -> None:
    """Light (H, W, 3) as a JPEG toned locally, with a gain map of a quarter of its size."""
    around = cv2.GaussianBlur(light.mean(axis=2), (0, 0), light.shape[1] / 40)[..., None]
    base = np.minimum(light / (0.6 + 0.9 * around), 1.0)
    stops = np.log2((light.mean(axis=2) + 1 / 64) / (base.mean(axis=2) + 1 / 64))
    small = cv2.resize(stops, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    low, high = float(small.min()), float(small.max())
    codes = np.rint((small - low) / (high - low) * 255.0).astype(np.uint8)
    shown = np.rint(srgb_picture(base) * 255.0).astype(np.uint8)
    numbers = (0.0, high, low, high, 1.0, 1 / 64, 1 / 64)
    block = struct.pack(">HHB", 0, 0, 0)
    for form, value in zip("IIiiIii", numbers, strict=True):
        block += struct.pack(f">{form}I", round(value * 10**6), 10**6)
    path.write_bytes(jpeg(shown, ISO + bytes(4)) + jpeg(codes, ISO + block))


def jpeg(codes: NDArray[np.uint8], content: bytes) -> bytes:
    """A JPEG with one more segment, APP2."""
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=95)
    data = file.getvalue()
    return data[:2] + b"\xff\xe2" + struct.pack(">H", len(content) + 2) + content + data[2:]


if __name__ == "__main__":
    given: Sequence[str] = sys.argv[1:]
    main(Path(given[0]), Path(given[1]), given[2] if len(given) > 2 else "crackle")
