"""Overwrite rules, and the marks in files by which they are decided.

A command replaces only files that the same command wrote, unless --overwrite is given, and never
its own inputs. The writing command is stored in the file:

    PNG     a tEXt chunk `Software` (PNG 3rd edition, 11.3.3)
    EXR     an attribute `Software`
    GIF     a comment
    MP4     a box `free` at the end (ISO/IEC 14496-12, 8.1.2)
    HTML    <meta name="generator">

A mark is "matcap relight" and the like, without a version. Folders of several files have it in
their JSON document: brdf/folder.py, export/targets.py.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.errors import MatcapError, UsageError
from matcap.files.maker import SOFTWARE

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngInfo

_AT_ONCE = 1 << 16  # first bytes of an HTML file that are searched for its generator
_BOX = re.compile(rb"(matcap [\w -]+)\Z")
_GENERATOR = re.compile(rb'<meta name="generator" content="(matcap [\w -]+)"')
_ELSEWHERE = "choose another name with -o"


def mark_mp4(path: Path, mark: str) -> None:
    """Append a mark to an MP4 file."""
    with path.open("ab") as file:
        file.write(struct.pack(">I", 8 + len(mark)) + b"free" + mark.encode())


def pillow_mark(mark: str) -> PngInfo:
    """Pillow's `pnginfo` with a mark."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text(SOFTWARE, mark)
    return info


def mark_of(path: Path) -> str:
    """The mark of a file; "" if it has none, or its format cannot have one."""
    read = _READERS.get(path.suffix.lower())
    try:
        return read(path) if read and path.is_file() else ""
    except (OSError, ValueError, SyntaxError):  # SyntaxError: Pillow on a damaged file
        return ""


def check_replaceable(
    paths: Iterable[Path],
    mark: str,
    *,
    inputs: Iterable[Path] = (),
    overwrite: bool = False,
    own: Callable[[Path], bool] = lambda _: False,
) -> None:
    """Refuse outputs that would replace an input, or a file that another command wrote.

    Args:
        inputs: files that the call reads, and folders of such files.
        overwrite: replace files of other commands.
        own: whether the command wrote a file without a mark.

    Raises:
        UsageError: an output is an input.
        MatcapError: an output exists, and the command has not written it.
    """
    read = {
        file.resolve()
        for given in inputs
        for file in (given.iterdir() if given.is_dir() else (given,))
    }
    for path in paths:
        if path.resolve() in read:
            raise UsageError.at(path, "the same command reads this file", "choose another name")
        if not path.exists() or overwrite:
            continue
        if path.is_dir():
            raise MatcapError.at(path, "this is a folder", _ELSEWHERE)
        if mark_of(path) != mark and not own(path):
            raise MatcapError.at(
                path,
                f"a file exists here, which {mark} has not written",
                f"{_ELSEWHERE}, or give --overwrite",
            )


def _of_picture(path: Path) -> str:
    """The mark of a PNG or a GIF."""
    from PIL import Image

    with Image.open(path) as picture:
        said = picture.info.get(SOFTWARE) or picture.info.get("comment") or ""
    return said.decode("latin-1") if isinstance(said, bytes) else str(said)


def _of_exr(path: Path) -> str:
    import OpenImageIO as oiio

    from matcap.files.exr import forget_error

    source = oiio.ImageInput.open(str(path))
    if source is None:
        forget_error(oiio.geterror)
        return ""
    try:
        return str(source.spec().getattribute(SOFTWARE) or "")
    finally:
        source.close()


def _of_mp4(path: Path) -> str:
    match = _BOX.search(path.read_bytes()[-64:])
    return match[1].decode() if match else ""


def _of_page(path: Path) -> str:
    with path.open("rb") as file:
        match = _GENERATOR.search(file.read(_AT_ONCE))
    return match[1].decode() if match else ""


_READERS: dict[str, Callable[[Path], str]] = {
    ".png": _of_picture, ".gif": _of_picture, ".exr": _of_exr, ".mp4": _of_mp4,
    ".html": _of_page, ".htm": _of_page,
}  # fmt: skip
