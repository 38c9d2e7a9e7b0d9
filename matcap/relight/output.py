"""Writes radiance to files: exposed and encoded (PNG, GIF, MP4), or linear (EXR)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import srgb_picture
from matcap.files.exr import write_exr
from matcap.files.names import check_suffix
from matcap.files.output import Output, write_error
from matcap.files.pixels import png_bytes
from matcap.relight.scene import Film

Radiance = NDArray[np.float32]
STILLS = (".png", ".exr")
MOVIES = (".gif", ".mp4", ".exr")
_FRAMES_PER_SECOND = 24
# Rows encoded together, to bound memory.
_STRIP = 256


def check_path(path: Path, *, moving: bool) -> None:
    """Raise UsageError unless the suffix is a picture's or, if `moving`, an animation's."""
    check_suffix(path, MOVIES if moving else STILLS, "animation" if moving else "picture")


def encode(radiance: Radiance, film: Film) -> Radiance:
    """Code values in [0, 1]: radiance times 2^exposure, clipped, through the transfer function."""
    light = radiance * np.float32(film.gain)
    return srgb_picture(light) if film.transfer == "srgb" else np.clip(light, 0.0, 1.0)


def write_still(radiance: Radiance, path: Path, film: Film) -> None:
    """Write a picture: .exr as float32 radiance, .png as 8-bit codes.

    Raises:
        UsageError: another suffix.
        MatcapError: values that are not finite; the file cannot be written.
    """
    check_path(path, moving=False)
    with Output.file(path) as file:
        if path.suffix.lower() == ".exr":
            write_exr(file, radiance, half=False)
        else:
            if not all(np.isfinite(row).all() for row in radiance):
                raise MatcapError.at(
                    path.name,
                    "the picture has values that are not finite",
                    "write it as .exr to see where",
                )
            file.write_bytes(png_bytes(_codes(radiance, film)))


def files_of(path: Path, frames: int | None = None) -> list[Path]:
    """Files of a picture, or of an animation of `frames` frames."""
    if frames is None or path.suffix.lower() != ".exr":
        return [path]
    return [path.with_name(frame_name(path, index)) for index in range(frames)]


def frame_name(path: Path, index: int) -> str:
    """File name of one frame of an animation in EXR: STEM_0000.exr."""
    return f"{path.stem}_{index:04d}.exr"


def write_movie(frames: Iterable[Radiance], path: Path, film: Film) -> None:
    """Write an animation, 24 frames a second: .gif, .mp4, or numbered .exr of radiance.

    Consumes one frame at a time. Files appear when the last is written.

    Raises:
        UsageError: another suffix.
        MatcapError: the files cannot be written.
    """
    check_path(path, moving=True)
    suffix = path.suffix.lower()
    with Output(path.parent).stage() as stage:
        if suffix == ".exr":
            for index, frame in enumerate(frames):
                write_exr(stage / frame_name(path, index), frame, half=False)
        elif suffix == ".gif":
            _write_gif(frames, stage / path.name, film)
        else:
            _write_mp4(frames, stage / path.name, film)


def _codes(frame: Radiance, film: Film) -> NDArray[np.uint8]:
    codes = np.empty(frame.shape, dtype=np.uint8)
    for top in range(0, len(frame), _STRIP):
        strip = slice(top, top + _STRIP)
        codes[strip] = np.rint(encode(frame[strip], film) * 255.0)
    return codes


def _write_gif(frames: Iterable[Radiance], path: Path, film: Film) -> None:
    from PIL import Image

    first, *rest = [
        Image.fromarray(_codes(frame, film)).quantize(256, dither=Image.Dither.FLOYDSTEINBERG)
        for frame in frames
    ]
    # GIF counts hundredths of a second.
    with path.open("wb") as file:
        first.save(
            file,
            "GIF",
            save_all=True,
            append_images=rest,
            duration=10 * round(100 / _FRAMES_PER_SECOND),
            loop=0,
        )


def _write_mp4(frames: Iterable[Radiance], path: Path, film: Film) -> None:
    import cv2

    writer = None
    for frame in frames:
        # The codec needs even sides: repeat the last row or column.
        codes = _codes(frame, film)
        codes = np.pad(codes, ((0, codes.shape[0] % 2), (0, codes.shape[1] % 2), (0, 0)), "edge")
        if writer is None:
            size = (codes.shape[1], codes.shape[0])
            kind = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(str(path), kind, _FRAMES_PER_SECOND, size)
            if not writer.isOpened():
                raise write_error(path, OSError("no MP4 encoder"))
        writer.write(np.ascontiguousarray(codes[..., ::-1]))
    if writer is not None:
        writer.release()
