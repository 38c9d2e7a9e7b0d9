"""Exporters: what textures hold, the metallic workflow, and every target of extreme maps."""

import math
import tempfile
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.export.job import ExportJob
from matcap.export.options import Container, Depth
from matcap.export.targets import DOCUMENTS, PRESETS, write_export
from matcap.export.texture_file import TextureFile
from matcap.export.workflows import SURE_METAL, MetallicAim, to_metallic
from matcap.files.color import srgb_decode
from matcap.files.exr import LARGEST_HALF, read_exr
from stable.edges.swept import Swept, compared, log_uniform

_TEXELS = 10_000
_CURVE = 3e-7  # of light: what 32-bit floats leave of the sRGB curve, there and back
_DEPTHS: tuple[Depth, ...] = ("8", "16", "half", "float")


def metallic(g: np.random.Generator) -> Swept:
    """The metallic workflow's diffuse and F0, put together again in float64.

    Both are right wherever base colours up to 1 can make them; elsewhere only metallic's range is.
    """
    diffuse = (g.random((_TEXELS, 3)) * g.choice([0.0, 1e-6, 1.0])).astype(np.float32)
    specular = (g.random(_TEXELS) ** int(g.integers(1, 5))).astype(np.float32)
    lowest, highest = [(0.0, 0.08), (0.04, 0.04), (0.02, 0.5)][int(g.integers(3))]
    row, half = specular[None], np.full((1, _TEXELS), 0.5, dtype=np.float32)
    made = to_metallic(MetallicAim(diffuse[None], row, half, lowest, highest))
    base, share = made.base[0].astype(np.float64), made.metallic[0].astype(np.float64)
    rest = 1.0 - share
    back = base * rest[:, None]
    f0 = made.dielectric[0] * rest + base.mean(-1) * share
    unclipped = (base < 1.0).all(-1) & (diffuse.max(-1) >= 1e-4)
    # Between a dielectric and a metal F0 is what metals in part may have, not what it was.
    result = (specular >= lowest) & ((specular <= highest) | (specular >= SURE_METAL))
    within = unclipped & result
    where = f"F0 of dielectrics {lowest:g} to {highest:g}"
    found = Swept(made.metallic.size, int((~((share >= 0.0) & (share <= 1.0))).sum()))
    if unclipped.any():
        found += compared(back[unclipped], diffuse[unclipped].astype(np.float64), 1.0, where)
    if within.any():
        found += compared(f0[within], specular[within].astype(np.float64), 1.0, where)
    return found


def textures(g: np.random.Generator) -> Swept:
    """What a file gives back, in half steps of its numbers; what it cannot hold is refused."""
    depth = _DEPTHS[int(g.integers(4))]
    srgb = bool(g.integers(2))
    values = g.random((100, 100), dtype=np.float32)
    if depth in ("half", "float"):
        values = (values * log_uniform(g, 1e-6, 1e6)).astype(np.float32)
    container: Container = "png" if depth in ("8", "16") else "exr"
    stored = TextureFile(lambda piece: values[piece.rows], depth, srgb, container=container)
    job = ExportJob(_even_maps(values.shape), "edge")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"texture{stored.suffix}"
        stored.write(path, job)
        if stored.suffix == ".png":
            whole = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
            read = whole / np.float64(2 ** int(depth) - 1)
            step = 0.5 / (2 ** int(depth) - 1)
            if srgb:
                # Half a step of code is as much light as the curve makes of it there.
                error = np.maximum(
                    np.abs(srgb_decode(np.minimum(read + step, 1.0)) - srgb_decode(read)),
                    np.abs(srgb_decode(np.maximum(read - step, 0.0)) - srgb_decode(read)),
                )
                # The curve itself is worked out in 32-bit floats.
                read, step = srgb_decode(read), error + _CURVE
        else:
            read = read_exr(path).pixels[..., 0].astype(np.float64)
            step = np.maximum(np.abs(values) * 2.0**-11, 2.0**-25) if depth == "half" else 1e-30
    held = np.abs(stored.seen(job.piece(slice(0, len(values)))) - read).max() <= 1e-6 * max(
        float(values.max()), 1e-6
    )
    off = np.abs(read - values) / step
    found = compared(off, np.zeros_like(off), 1.0, f"{depth}{', sRGB' if srgb else ''}")
    overflow = depth == "half" and float(values.max()) > LARGEST_HALF
    return found + Swept(0, broken=int(overflow or not held))


def targets(g: np.random.Generator) -> Swept:
    """Every target and preset of extreme maps: numbers in documents and residuals are finite."""
    maps = _maps(g)
    found = Swept()
    for name in dict.fromkeys((*DOCUMENTS, *PRESETS)):
        with tempfile.TemporaryDirectory() as folder:
            exported = write_export(ExportJob(maps, "edge"), name, Path(folder))
            texts = [
                path.read_text(encoding="utf-8", errors="replace").lower()
                for path in Path(folder).iterdir()
                if path.suffix in (".json", ".xml", ".mtlx", ".usda")
            ]
        numbers = [number for text in texts for number in _numbers(text)]
        if exported.residual is not None:
            numbers += [exported.residual.mean, exported.residual.worst]
        broken = sum(not math.isfinite(number) for number in numbers)
        found += Swept(maps.height.numel() + len(numbers), broken, where=name if broken else "")
    return found


def _numbers(text: str) -> list[float]:
    """All words of a document that are numbers, NaN and infinity included."""
    found = []
    for word in (
        text.replace(",", " ").replace('"', " ").replace("(", " ").replace(")", " ").split()
    ):
        try:
            found.append(float(word))
        except ValueError:
            continue
    return found


def _even_maps(shape: tuple[int, ...]) -> MapSet:
    one = torch.full((1, *shape), 0.5)
    return MapSet(one.expand(3, *shape), 0.08 * one, one, 0.0 * one, 1.0)


def _maps(g: np.random.Generator) -> MapSet:
    def field(planes: int) -> NDArray[np.float64]:
        ends = g.choice([0.0, 1e-6, 0.04, 0.5, 1.0], 2)
        return np.asarray(ends.min() + np.ptp(ends) * g.random((planes, 16, 24)))

    lift = float(log_uniform(g, 1e-9, 1e5) * g.integers(2))
    diffuse, specular, roughness, height = (
        torch.from_numpy(one).float() for one in (field(3), field(1), field(1), lift * field(1))
    )
    texel_size = float(log_uniform(g, 1e-5, 10.0))
    return MapSet(diffuse, specular, roughness, height, texel_size, periodic=True)
