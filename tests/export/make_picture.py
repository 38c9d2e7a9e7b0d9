"""The picture of the guide: `python tests/export/make_picture.py MATERIAL.matcap OUT.jpg`.

One piece under the light called top, by six programs: above matcap, Blender (BLENDER_PYTHON names a
Python with bpy) and Mitsuba's NAME.xml; below three.js, Babylon.js and MaterialX's own shader, in
Chromium. Prints how far each is from matcap, averaged over 16 x 16 pixels.
"""

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import render_babylon
import render_three
from exported import unlike
from read_materialx import render
from round_trips import blender_picture, lit, mitsuba_picture, point_light

from matcap.export.job import ExportJob
from matcap.export.targets import write_export
from matcap.field.opened import open_tile
from matcap.files.srgb import srgb_picture
from matcap.relight.scene import NAMED_LIGHTS, exposing_intensity

SIDE = 256


def main(material: Path, out: Path) -> None:
    maps = open_tile(material, size=(SIDE, SIDE)).maps
    place = NAMED_LIGHTS["top"]
    with tempfile.TemporaryDirectory() as kept:
        folder = {
            target: Path(kept) / target for target in ("materialx", "mitsuba", "blender", "gltf")
        }
        for target, here in folder.items():
            write_export(ExportJob(maps, "m"), target, here)
        drawn = (folder["gltf"] / "m.glb", maps, place, exposing_intensity(place))
        pictures = {
            "matcap": lit(maps),
            "Blender": blender_picture(folder["blender"] / "m_blender.py", maps),
            "Mitsuba": mitsuba_picture(folder["mitsuba"], "m.xml"),
            "three.js": render_three.render(*drawn),
            "Babylon.js": render_babylon.render(*drawn),
            "MaterialX": render(folder["materialx"] / "m.mtlx", maps, point_light()),
        }
    for name, picture in pictures.items():
        print(f"{name}: {unlike(picture, pictures['matcap']):.2%}")
    framed = [
        np.pad(one, ((2, 2), (2, 2), (0, 0)), constant_values=1.0) for one in pictures.values()
    ]
    sheet = np.vstack([np.hstack(framed[:3]), np.hstack(framed[3:])]).astype(np.float32)
    coded = np.rint(srgb_picture(sheet)[..., ::-1] * 255.0).astype(np.uint8)
    cv2.imwrite(str(out), coded, [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
