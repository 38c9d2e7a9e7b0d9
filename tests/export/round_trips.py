"""Measure all exports: `python tests/export/round_trips.py [-r] [MATERIAL.matcap ...]`.

Each material (by default the procedural ones that matcap simulates) is exported to every target,
checked by the target's validator, read back by its library and compared with matcap; with -r also
rendered: MaterialX's shaders, three.js and Babylon.js in Chromium, Mitsuba, and Blender where
BLENDER_PYTHON names a Python with bpy; pictures are compared as means of 16 x 16 pixels. Prints the
table of docs/notes/exports.md: light that differs, as a share of all light, mean and worst of the
materials. What is not installed is left out and said.
"""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import render_babylon
import render_three
from exported import unlike

import matcap
from matcap.export.engines import ENGINES
from matcap.export.job import ExportJob
from matcap.export.surface import residual
from matcap.export.targets import DOCUMENTS, write_export
from matcap.field.opened import open_tile
from matcap.files.exr import read_exr
from matcap.lab.simulate.materials import MATERIALS, realise
from matcap.relight.scene import (
    NAMED_LIGHTS,
    PointLight,
    exposing_intensity,
)

SIZE = 64
LOBES = "none,+diffuse,+specular,+falloff"


def lit(maps) -> np.ndarray:
    """Under the light called top."""
    return matcap.relight(maps, "top", effects=LOBES)


def checked(target, folder, name):
    """(complaints, surface) of the target's own library; None where it is not installed."""
    if target == "materialx" and find_spec("MaterialX"):
        import read_materialx as library

        file = folder / f"{name}.mtlx"
    elif target == "usd" and find_spec("pxr"):
        import read_usd as library

        file = folder / f"{name}.usdz"
    elif target == "gltf":
        import read_gltf as library

        file = folder / f"{name}.glb"
        if not library.has_validator():
            return None, library.surface(file)
    else:
        return None, None
    return library.complaints(file), library.surface(file)


def rendered(target, folder, name, maps):
    """{what: difference} of pictures; empty where nothing that renders is installed."""
    if target == "materialx" and find_spec("MaterialX") and find_spec("playwright"):
        return materialx_pictures(folder, name, maps)
    if target == "mitsuba" and find_spec("mitsuba"):
        return {
            f"mitsuba, {what}": unlike(mitsuba_picture(folder, file), lit(maps))
            for what, file in (("plain", f"{name}.xml"), ("exact", f"{name}_exact.xml"))
        }
    endings = {"blender": "_blender.py", "usd": ".usda", "gltf": ".glb"}
    file = folder / f"{name}{endings[target]}" if target in endings else None
    found = {}
    if file and "BLENDER_PYTHON" in os.environ:
        found["in Blender"] = blender_picture(file, maps)
    place, drawing = NAMED_LIGHTS["top"], file and target != "blender" and find_spec("playwright")
    power = exposing_intensity(place)
    if drawing and render_three.PLACE.is_dir():
        found["in three.js"] = render_three.render(file, maps, place, power)
    if drawing and target == "usd" and render_three.PLACE.is_dir():
        found["in three.js, its normals undoubled"] = render_three.render(
            file, maps, place, power, plain_normals=True
        )
    if drawing and target == "gltf" and render_babylon.PLACE.is_dir():
        found["in Babylon.js"] = render_babylon.render(file, maps, place, power)
    return {f"{target}, {where}": unlike(picture, lit(maps)) for where, picture in found.items()}


def top_light() -> PointLight:
    """The light called top."""
    place = NAMED_LIGHTS["top"]
    return PointLight(place, (exposing_intensity(place),) * 3)


def materialx_pictures(folder, name, maps):
    """The same of MaterialX's shader, of each of its documents."""
    from read_materialx import render

    ways = (
        ("one bounce", "", False),
        ("its own bounces", "", True),
        ("open_pbr_surface", "_openpbr", True),
        ("standard_surface", "_standard_surface", True),
    )
    return {
        f"materialx, {what}": unlike(
            render(folder / f"{name}{variant}.mtlx", maps, top_light(), compensated=full), lit(maps)
        )
        for what, variant, full in ways
    }


def mitsuba_picture(folder, file) -> np.ndarray:
    """One texel a pixel: what is measured is reflectance, not how pictures are filtered."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    if "matcap_bsdf" not in sys.modules:
        sys.path.insert(0, str(folder))
        import matcap_bsdf  # noqa: F401
    nearest = '<string name="filter_type" value="nearest"/><boolean name="raw"'
    text = (folder / file).read_text().replace('<boolean name="raw"', nearest)
    (folder / "nearest.xml").write_text(text)
    picture = mi.render(mi.load_file(str(folder / "nearest.xml")), spp=16)
    return np.array(picture)[..., :3]


def blender_picture(file, maps) -> np.ndarray:
    """Cycles' picture of a script, stage or binary, in the units of the light called top."""
    width, height = maps.size
    out = file.with_suffix(".exr")
    extent = max(width, height) * maps.texel_size
    script = Path(__file__).with_name("render_blender.py")
    words = [os.environ["BLENDER_PYTHON"], "-W", "ignore", script, file, width, height]
    subprocess.run([str(w) for w in (*words, extent, out)], check=True, capture_output=True)
    # A lamp of P watts has a radiant intensity of P / (4 pi).
    scale = exposing_intensity((0.0, 2.0, 1.2)) * 4.0 * np.pi / 1000.0
    return read_exr(out)[..., :3] * scale


def materials(paths):
    """(name, maps) of each."""
    if not paths:
        for name in MATERIALS:
            yield name, realise(name, SIZE, SIZE, 1, 2.0 / SIZE).map(lambda map_: map_.float())
    for path in paths:
        yield f"m{len(path.stem)}", open_tile(path, size=(SIZE, SIZE)).maps


def main(words) -> None:
    rows: dict[str, list[float]] = {}
    faults: dict[str, list[str]] = {}
    count = 0
    with tempfile.TemporaryDirectory() as place:
        for name, maps in materials([Path(word) for word in words if word != "-r"]):
            count += 1
            for target in DOCUMENTS:
                folder = Path(place) / f"{count}_{target}"
                done = write_export(ExportJob(maps, name), target, folder)
                for form, off in done.residuals.items():
                    rows.setdefault(f"{target}, {form}, residual told", []).append(off.mean)
                found, surface = checked(target, folder, name)
                if found is not None:
                    faults.setdefault(target, []).extend(found)
                if surface is not None:
                    off = residual(maps, surface).mean
                    rows.setdefault(f"{target}, read back", []).append(off)
                if "-r" in words:
                    for what, off in rendered(target, folder, name, maps).items():
                        rows.setdefault(f"{what}, rendered", []).append(off)
            for preset in ENGINES:
                done = write_export(
                    ExportJob(maps, name), preset, Path(place) / f"{count}_{preset}p"
                )
                rows.setdefault(f"preset {preset}, as written", []).append(done.residual.mean)
                for form, off in done.residuals.items():
                    rows.setdefault(f"preset {preset}, {form}", []).append(off.mean)
    print(f"{count} materials of {SIZE} x {SIZE} texels\n")
    print("| target | mean | worst material |\n| --- | --- | --- |")
    for what, values in rows.items():
        print(f"| {what} | {np.mean(values):.3%} | {max(values):.3%} |")
    for target in ("materialx", "usd", "gltf"):
        said = f"{len(faults[target])} complaints" if target in faults else "not installed"
        print(f"\n{target} validator: {said}")
        for fault in faults.get(target, []):
            print(f"  {fault}")


if __name__ == "__main__":
    main(sys.argv[1:])
