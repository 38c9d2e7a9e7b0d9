"""The picture of the guide: `python tests/export/make_picture.py MATERIAL.matcap OUT.jpg`.

Above, under the light called top: matcap, Mitsuba's NAME.xml, and Blender's Cycles (where
BLENDER_PYTHON names a Python with bpy). Below, under a distant light: matcap, MaterialX's own
shader in Chromium, and twenty times the difference of the two.
"""

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from read_materialx import render
from round_trips import DIRECTION, blender_picture, lit, mitsuba_picture

import matcap
from matcap.export.targets import write_export
from matcap.export.textures import ExportJob
from matcap.files.srgb import srgb_picture
from matcap.model.opened import open_tile
from matcap.relight.scene import DirectionalLight, Scene, Surface

SIDE = 256


def main(material: Path, out: Path) -> None:
    maps = open_tile(material, size=(SIDE, SIDE)).maps
    with tempfile.TemporaryDirectory() as place:
        folders = {target: Path(place) / target for target in ("materialx", "mitsuba", "blender")}
        for target, folder in folders.items():
            write_export(ExportJob(maps, "m"), target, folder)
        above = [
            lit(maps),
            mitsuba_picture(folders["mitsuba"], "m.xml"),
            blender_picture(folders["blender"] / "m_blender.py", maps),
        ]
        light = DirectionalLight(DIRECTION, (3.0, 3.0, 3.0))
        scene = Scene(film=None, surface=Surface(size=None), lights=(light,))
        true = matcap.relight(maps, scene, effects="none,+diffuse,+specular")
        theirs = render(folders["materialx"] / "m.mtlx", maps, DIRECTION, 3.0)
        below = [true, theirs, 20.0 * np.abs(theirs - true)]
    framed = [np.pad(one, ((2, 2), (2, 2), (0, 0)), constant_values=1.0) for one in above + below]
    sheet = np.vstack([np.hstack(framed[:3]), np.hstack(framed[3:])]).astype(np.float32)
    coded = np.rint(srgb_picture(sheet)[..., ::-1] * 255.0).astype(np.uint8)
    cv2.imwrite(str(out), coded, [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
