"""Tiled textures with mipmaps, for renderers' texture caches: .exr, or .tx (TIFF or EXR)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TILE = 64


def write_tiled(path: Path, pixels: NDArray[Any], *, srgb: bool, wrap: str) -> None:
    """Write encoded pixels.

    Args:
        path: .exr, or .tx: EXR for floats, TIFF for integers.
        pixels: (H, W), (H, W, 3) or (H, W, 4) integers or floats.
        srgb: integers are sRGB-encoded; the file states it, and mipmaps average linear light.
        wrap: "periodic" or "clamp".

    Raises:
        OSError: the file cannot be written.
    """
    import OpenImageIO as oiio

    planes = np.ascontiguousarray(pixels if pixels.ndim == 3 else pixels[..., None])
    spec = oiio.ImageSpec(
        planes.shape[1], planes.shape[0], planes.shape[2], oiio.TypeDesc(_TYPES[planes.dtype.name])
    )
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(), planes)
    config = oiio.ImageSpec()
    config.tile_width = config.tile_height = _TILE
    config.attribute("maketx:wrapmodes", f"{wrap},{wrap}")
    config.attribute("maketx:sharpen", 0.0)
    config.attribute("maketx:constant_color_detect", 0)
    config.attribute("oiio:ColorSpace", "srgb_rec709_scene" if srgb else "data")
    whole = planes.dtype.kind == "u"
    config.attribute("maketx:fileformatname", "tiff" if whole else "openexr")
    config.attribute("compression", "zip")
    if not oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, buffer, str(path), config):
        raise OSError(oiio.geterror() or f"{path.name} could not be written")


_TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}
