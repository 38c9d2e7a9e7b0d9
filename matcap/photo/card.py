"""The printable calibration card: a ChArUco board for scale and tilt, and 24 colour patches.

Drawn as rectangles in millimetres, for SVG, PDF and tests alike. Patches are arranged as on a
ColorChecker Classic, with its published sRGB values (X-Rite, D65, before November 2014). Printing
changes colours, so that a printed card serves for scale; for colours photograph a real
ColorChecker.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from matcap.files.names import check_suffix
from matcap.files.output import Output

PAGE = (210.0, 297.0)  # mm, A4
SQUARES = (7, 5)  # of the board
SQUARE, MARKER = 24.0, 18.0  # mm, sides
BOARD_AT = (21.0, 24.0)  # mm, the board's upper left corner on the page
_PATCH, _GAP, _MARGIN = 23.0, 3.0, 5.0  # mm; _MARGIN is the width of the black frame
PATCHES_AT = (24.5, 158.0)
PATCHES_SIZE = (6 * _PATCH + 5 * _GAP, 4 * _PATCH + 3 * _GAP)
_CELLS = 6  # cells along a 4 x 4 marker's side, including its black border

# sRGB, row by row from dark skin to black.
PATCHES = (
    (115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170),
    (214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46),
    (56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161),
    (243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52),
)  # fmt: skip
_TITLE = "matcap calibration card"
_NOTES = (
    f"Print at 100 % on matt paper. Each square of the board is {SQUARE:g} mm: measure it.",
    "Photograph it flat, with the flash, as the samples are: same distance, same exposure.",
)


@dataclass(frozen=True)
class CardRectangle:
    """A filled rectangle, in millimetres from the page's upper left corner; colour in sRGB."""

    x: float
    y: float
    width: float
    height: float
    colour: tuple[int, int, int] = (0, 0, 0)


def rectangles() -> Iterator[CardRectangle]:
    """The rectangles of the card, back to front."""
    columns, rows = SQUARES
    for row in range(rows):
        for column in range(columns):
            x, y = BOARD_AT[0] + column * SQUARE, BOARD_AT[1] + row * SQUARE
            if (row + column) % 2 == 0:
                yield CardRectangle(x, y, SQUARE, SQUARE)
    inset = (SQUARE - MARKER) / 2.0
    whites = [(r, c) for r in range(rows) for c in range(columns) if (r + c) % 2]
    for number, (row, column) in enumerate(whites):
        x = BOARD_AT[0] + column * SQUARE + inset
        y = BOARD_AT[1] + row * SQUARE + inset
        yield from _marker(number, x, y)
    (left, top), (width, height) = PATCHES_AT, PATCHES_SIZE
    yield CardRectangle(left - _MARGIN, top - _MARGIN, width + 2 * _MARGIN, height + 2 * _MARGIN)
    for index, colour in enumerate(PATCHES):
        row, column = divmod(index, 6)
        x, y = left + column * (_PATCH + _GAP), top + row * (_PATCH + _GAP)
        yield CardRectangle(x, y, _PATCH, _PATCH, colour)


def write_card(path: Path) -> None:
    """Write the card as a page to print.

    Raises:
        UsageError: the name ends neither in .svg nor in .pdf.
        MatcapError: the file cannot be written.
    """
    forms = {".svg": _svg, ".pdf": _pdf}
    check_suffix(path, tuple(forms), "card")
    with Output.file(path) as file:
        file.write_bytes(forms[path.suffix.lower()]())


def board() -> Any:  # noqa: ANN401
    """OpenCV's description of the ChArUco board, in millimetres."""
    import cv2

    return cv2.aruco.CharucoBoard(SQUARES, SQUARE, MARKER, _dictionary())


def _dictionary() -> Any:  # noqa: ANN401
    import cv2

    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def _marker(number: int, x: float, y: float) -> Iterator[CardRectangle]:
    import cv2

    cells = cv2.aruco.generateImageMarker(_dictionary(), number, _CELLS, borderBits=1)
    side = MARKER / _CELLS
    yield CardRectangle(x, y, MARKER, MARKER)
    for row, column in np.argwhere(cells > 127):
        yield CardRectangle(x + column * side, y + row * side, side, side, (255, 255, 255))


def _svg() -> bytes:
    width, height = PAGE
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">',
        f"<title>{_TITLE}</title>",
        f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>',
    ]
    for r in rectangles():
        red, green, blue = r.colour
        lines.append(
            f'<rect x="{r.x:g}" y="{r.y:g}" width="{r.width:g}" height="{r.height:g}" '
            f'fill="#{red:02x}{green:02x}{blue:02x}"/>'
        )
    for (x, y), size, text in _texts():
        lines.append(
            f'<text x="{x:g}" y="{y:g}" font-family="Helvetica, Arial, sans-serif" '
            f'font-size="{size:g}">{text}</text>'
        )
    return "\n".join([*lines, "</svg>", ""]).encode()


def _texts() -> Iterator[tuple[tuple[float, float], float, str]]:
    """(position in mm, size in mm, text) of all text."""
    yield (BOARD_AT[0], 16.0), 5.0, _TITLE
    for index, text in enumerate(_NOTES):
        yield (BOARD_AT[0], 276.0 + 5.5 * index), 3.6, text


def _pdf() -> bytes:
    """The card as a page of PDF 1.4, with text in Helvetica, which need not be embedded."""
    unit = 72.0 / 25.4  # points a millimetre
    height = PAGE[1]
    drawn = []
    for r in rectangles():
        colour = " ".join(f"{value / 255:.4f}" for value in r.colour)
        place = (r.x, height - r.y - r.height, r.width, r.height)
        drawn.append(f"{colour} rg {' '.join(f'{v * unit:.4f}' for v in place)} re f")
    drawn.append("0 0 0 rg")
    for (x, y), size, text in _texts():
        at = f"{x * unit:.2f} {(height - y) * unit:.2f}"
        drawn.append(f"BT /F {size * unit:.2f} Tf {at} Td ({text}) Tj ET")
    stream = "\n".join(drawn).encode("ascii")
    box = f"[0 0 {PAGE[0] * unit:.4f} {PAGE[1] * unit:.4f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    page, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        places.append(len(page))
        page += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    size = len(objects) + 1
    return page + (
        b"xref\n0 %d\n0000000000 65535 f \n%btrailer\n<< /Size %d /Root 1 0 R >>\n"
        b"startxref\n%d\n%%%%EOF\n" % (size, table, size, len(page))
    )
