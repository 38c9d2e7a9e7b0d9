"""Photograph files with changed bytes: each is read, or refused in one sentence.

`python tests/lab/stability/mutated.py 5000 [seed]` makes and reads so many and prints what came of
them; anything but a Photo or a MatcapError is printed with the seed that makes it again.
"""

from __future__ import annotations

import struct
import sys
import tempfile
import traceback
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.photograph import PhoneCamera, Shot
from matcap.lab.simulate.write_dng import Sensor, write_dng
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo

sys.path.insert(0, str(Path(__file__).parents[2] / "photo"))
from icc_files import ink_profile, matrix_profile


def whole_files(folder: Path) -> dict[str, bytes]:
    """Small files of every kind that is read, with what they may state of themselves."""
    y, x = np.mgrid[0:72, 0:96]
    codes = np.stack([20 + 2 * x, 40 + 2 * y, 60 + (x * y) % 150], axis=-1).astype(np.uint8)
    alpha = np.where(x > 20, 255, 0).astype(np.uint8)
    exif = Image.Exif()
    exif.update({0x0112: 6})
    exif.get_ifd(0x8769).update({0xA405: 26, 0xA001: 65535, 0x920A: 4.0, 0xA20E: 1000.0})
    picture, cut_out = Image.fromarray(codes), Image.fromarray(np.dstack([codes, alpha]))
    xmp = b'<x tiff:Orientation="3" exif:FocalLengthIn35mmFilm="26"/>'
    picture.save(folder / "a.jpg", exif=exif, xmp=xmp, icc_profile=matrix_profile())
    picture.convert("CMYK").save(folder / "inks.jpg", icc_profile=ink_profile())
    cut_out.save(folder / "a.png", exif=exif, icc_profile=matrix_profile())
    stated = PngImagePlugin.PngInfo()
    stated.add(b"gAMA", struct.pack(">I", 55_000))
    stated.add(
        b"cHRM", struct.pack(">8I", 31_270, 32_900, 68_000, 32_000, 26_500, 69_000, 15_000, 6_000)
    )
    stated.add_text("Comment", 3000 * "-")  # where changes do no harm
    picture.convert("L").save(folder / "grey.png", pnginfo=stated)
    cut_out.save(folder / "a.webp", exif=exif, xmp=xmp)
    picture.save(folder / "a.avif", exif=exif)
    deep = codes.astype(np.uint16) * 257
    with tifffile.TiffWriter(folder / "pages.tif") as file:
        file.write(codes[:64, :64], photometric="rgb", subfiletype=1)
        file.write(deep, photometric="rgb", compression="zlib", iccprofile=matrix_profile())
    tifffile.imwrite(folder / "lab.tif", codes, photometric="cielab")
    tifffile.imwrite(folder / "float.tif", (codes / 255).astype(np.float32), photometric="rgb")
    shot = Shot((codes / 400.0).astype(np.float64), FlashSetup(), PhoneCamera(width=96, height=72))
    write_dng(folder / "a.dng", shot, Sensor(shading=0.3), 1)
    try:
        import pillow_heif
    except ImportError:
        pass
    else:
        pillow_heif.from_pillow(picture).save(folder / "a.heic", exif=exif.tobytes())
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The file with some bytes changed, most of them near its start, where headers are."""
    changed: NDArray[np.uint8] = np.frombuffer(data, np.uint8).copy()
    how = rng.integers(5)
    if how == 0:  # cut off
        return bytes(changed[: rng.integers(1, len(changed))])
    if how == 1:  # a stretch moved
        size = int(rng.integers(1, min(64, len(changed) // 2)))
        to, of = rng.integers(0, len(changed) - size, 2)
        changed[to : to + size] = changed[of : of + size].copy()
        return bytes(changed)
    reach = len(changed) if how == 2 else min(len(changed), 700)
    places = rng.integers(0, reach, rng.integers(1, 9))
    if how == 4:  # numbers at their ends
        changed[places] = rng.choice([0, 1, 127, 128, 255], len(places))
    else:
        changed[places] = rng.integers(0, 256, len(places))
    return summed(bytes(changed)) if rng.integers(2) else bytes(changed)


def summed(data: bytes) -> bytes:
    """A PNG with right check sums, or whatever it is: else hardly any changed PNG would be read."""
    if not data.startswith(b"\x89PNG"):
        return data
    mended, at = bytearray(data), 8
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        end = at + 8 + size
        if end + 4 > len(data):
            break
        struct.pack_into(">I", mended, end, zlib.crc32(data[at + 4 : end]))
        at = end + 4
    return bytes(mended)


def read_mutated(count: int, seed: int = 0) -> Iterator[tuple[str, str]]:
    """(kind, what came of it) of so many files: "read", "refused", or a traceback."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        whole = whole_files(folder)
        names = list(whole)
        for number in range(count):
            name = names[number % len(names)]
            file = folder / f"mutated-{name}"
            file.write_bytes(mutated(whole[name], np.random.default_rng((seed, number))))
            yield name, _outcome(file, f"seed {seed}, number {number}")


def _outcome(file: Path, which: str) -> str:
    try:
        photo = load_photo(file, long_side=80, noise=False)
    except MatcapError as error:
        return "refused" if "\n" not in str(error) else f"{which}: more than a line: {error}"
    except BaseException:
        return f"{which}: {traceback.format_exc()}"
    sound = isinstance(photo, Photo) and bool(np.isfinite(photo.pixels).all())
    return "read" if sound and photo.pixels.min() >= 0.0 else f"{which}: numbers that are none"


def main(count: int, seed: int) -> int:
    """Print what came of so many; 1 if anything was neither read nor refused."""
    found: Counter[tuple[str, str]] = Counter()
    wrong = 0
    for name, outcome in read_mutated(count, seed):
        if outcome in ("read", "refused"):
            found[name, outcome] += 1
        else:
            wrong += 1
            print(name, outcome)
    for (name, outcome), number in sorted(found.items()):
        print(f"{name:12} {outcome:8} {number}")
    print(f"{count} files, {wrong} neither read nor refused")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0))
