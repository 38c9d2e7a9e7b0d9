"""Measure all exports: `python lab/tests/export/round_trips.py [-r] [-m] [MATERIAL.matcap ...]`.

Each material (by default the procedural ones that matcap simulates; with -m the metals of
metals.py) is exported to every target, checked by the target's validator, read back by its library
and compared with matcap; with -r also rendered under a high light and a grazing one: MaterialX's
shaders and three.js in Chromium, Mitsuba, and Blender where BLENDER_PYTHON names a
Python with bpy; pictures are compared as means of 16 x 16 pixels. Prints the tables of
docs/notes/exports.md: light that differs, as a share of all light, mean and worst of the materials,
and what each of them has. What is not installed is left out and said.
"""

# ruff: noqa: E402
import os
import subprocess
import sys
import tempfile
from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[3] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "export")]
import render_three
from chromium import browsing
from exported import unlike
from metals import metals
from simulated.materials import MATERIALS, realise
from target_surfaces import residual

import matcap
from matcap.export import workflows
from matcap.export.job import ExportJob
from matcap.export.presets import PRESETS
from matcap.export.shading import residuals
from matcap.export.targets import DOCUMENTS, TARGETS, write_export
from matcap.field.opened import open_tile
from matcap.files.exr import read_exr
from matcap.relight.scene import NAMED_LIGHTS, PointLight, exposing_intensity, scene_from_light

SIZE = 64
LOBES = "none,+diffuse,+specular,+falloff"
# 72 and 12 degrees above the middle of the plane.
LIGHTS = {"high": (0.4, 0.5, 2.0), "grazing": (0.0, 2.0, 0.425)}


def lit(maps, place=NAMED_LIGHTS["top"]) -> np.ndarray:
    """Under a point light, by default the one called top."""
    light = ",".join(str(c) for c in place)
    return matcap.relight(maps, scene_from_light(light), effects=LOBES)


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


def rendered(target, folder, name, maps, place):
    """{what: picture}; empty where nothing that renders is installed."""
    if target == "materialx" and find_spec("MaterialX") and find_spec("playwright"):
        return materialx_pictures(folder, name, maps, place)
    if target == "mitsuba" and find_spec("mitsuba"):
        return {
            f"mitsuba, {what}": mitsuba_picture(folder, file, place)
            for what, file in (("plain", f"{name}.xml"), ("exact", f"{name}_exact.xml"))
        }
    endings = {"blender": "_blender.py", "usd": ".usda", "gltf": ".glb"}
    file = folder / f"{name}{endings[target]}" if target in endings else None
    found = {}
    if file and "BLENDER_PYTHON" in os.environ:
        found["in Blender"] = blender_picture(file, maps, place)
        if target != "blender":
            found["in Blender, bump correction off"] = blender_picture(
                file, maps, place, corrected=False
            )
    drawing = file and target != "blender" and find_spec("playwright")
    power = exposing_intensity(place)
    if drawing and render_three.PLACE.is_dir():
        found["in three.js"] = render_three.render(file, maps, place, power)
    if drawing and target == "usd" and render_three.PLACE.is_dir():
        found["in three.js, its normals undoubled"] = render_three.render(
            file, maps, place, power, plain_normals=True
        )
    return {f"{target}, {where}": picture for where, picture in found.items()}


def point_light(place=NAMED_LIGHTS["top"]) -> PointLight:
    """By default the light called top."""
    return PointLight(place, (exposing_intensity(place),) * 3)


def materialx_pictures(folder, name, maps, place):
    """The same of MaterialX's shader, of each of its documents."""
    from read_materialx import render

    ways = (
        ("one bounce", "", False),
        ("its own bounces", "", True),
        ("open_pbr_surface", "_openpbr", True),
        ("standard_surface", "_standard_surface", True),
    )
    return {
        f"materialx, {what}": render(
            folder / f"{name}{variant}.mtlx", maps, point_light(place), compensated=full
        )
        for what, variant, full in ways
    }


def mitsuba_picture(folder, file, place=NAMED_LIGHTS["top"]) -> np.ndarray:
    """One texel a pixel: what is measured is reflectance, not how pictures are filtered."""
    import xml.etree.ElementTree as ET

    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    if "matcap_bsdf" not in sys.modules:
        sys.path.insert(0, str(folder))
        import matcap_bsdf  # noqa: F401
    nearest = '<string name="filter_type" value="nearest"/><boolean name="raw"'
    scene = ET.fromstring((folder / file).read_text().replace('<boolean name="raw"', nearest))
    emitter = scene.find("emitter")
    emitter.find("point").set("value", ", ".join(str(c) for c in place))
    emitter.find("rgb").set("value", repr(exposing_intensity(place)))
    (folder / "nearest.xml").write_bytes(ET.tostring(scene))
    return np.array(mi.render(mi.load_file(str(folder / "nearest.xml")), spp=16))[..., :3]


def blender_picture(file, maps, place=NAMED_LIGHTS["top"], *, corrected=True) -> np.ndarray:
    """Cycles' picture of a script, stage or binary; `corrected` is its bump-map correction."""
    width, height = maps.size
    out = file.with_suffix(".exr")
    extent = max(width, height) * maps.texel_size
    script = Path(__file__).with_name("render_blender.py")
    words = [os.environ["BLENDER_PYTHON"], "-W", "ignore", script, file, width, height]
    words += [extent, *place, out, *([] if corrected else ["uncorrected"])]
    subprocess.run([str(w) for w in words], check=True, capture_output=True)
    # A lamp of P watts has a radiant intensity of P / (4 pi).
    scale = exposing_intensity(place) * 4.0 * np.pi / 1000.0
    return read_exr(out).pixels[..., :3] * scale


def materials(paths, metallic):
    """(name, maps) of each."""
    if metallic:
        yield from ((name.replace(" ", "-"), maps) for name, maps in metals().items())
    elif not paths:
        for name in MATERIALS:
            yield name, realise(name, SIZE, SIZE, 1, 2.0 / SIZE).map(lambda map_: map_.float())
    for path in paths:
        yield path.stem, open_tile(path, size=(SIZE, SIZE)).maps


def metallic_forms(maps, preset):
    """{form: residual} of the ways in which base colour and metallic may be found."""
    make, found, all_forms = TARGETS[preset]["metallic"], {}, workflows.FORMS
    for form in all_forms:
        workflows.FORMS = (form,)
        job = ExportJob(maps, "m")
        found[form] = residuals(job, make(job).surfaces)["metallic"].mean
    workflows.FORMS = all_forms
    return found


def main(words) -> None:
    rows: dict[str, list[float]] = {}
    names: list[str] = []
    faults: dict[str, list[str]] = {}
    count = 0
    browser = browsing() if "-r" in words and find_spec("playwright") else nullcontext()
    with tempfile.TemporaryDirectory() as kept, browser:
        paths = [Path(word) for word in words if word not in ("-r", "-m")]
        for name, maps in materials(paths, "-m" in words):
            names.append(name)
            count += 1
            for target in DOCUMENTS:
                folder = Path(kept) / f"{count}_{target}"
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
                    for height, place in LIGHTS.items():
                        true = lit(maps, place)
                        for what, picture in rendered(target, folder, name, maps, place).items():
                            row = rows.setdefault(f"{what}, rendered, {height}", [])
                            row.append(unlike(picture, true))
            for preset in (one for one, forms in PRESETS.items() if None not in forms):
                done = write_export(
                    ExportJob(maps, name), preset, Path(kept) / f"{count}_{preset}p"
                )
                rows.setdefault(f"preset {preset}, as written", []).append(done.residual.mean)
                for form, off in done.residuals.items():
                    rows.setdefault(f"preset {preset}, {form}", []).append(off.mean)
                for form, off in metallic_forms(maps, preset).items():
                    rows.setdefault(f"preset {preset}, metallic, {form}", []).append(off)
    print(f"{count} materials of {SIZE} x {SIZE} texels\n")
    print(f"| target | mean | worst | {' | '.join(names)} |\n|{' --- |' * (3 + count)}")
    for what, values in rows.items():
        each = " | ".join(f"{value:.2%}" for value in values)
        print(f"| {what} | {np.mean(values):.3%} | {max(values):.3%} | {each} |")
    for target in ("materialx", "usd", "gltf"):
        said = f"{len(faults[target])} complaints" if target in faults else "not installed"
        print(f"\n{target} validator: {said}")
        for fault in faults.get(target, []):
            print(f"  {fault}")


if __name__ == "__main__":
    main(sys.argv[1:])
