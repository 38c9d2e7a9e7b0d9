"""ICC profiles, built tag by tag from the numbers a test knows."""

import itertools
import struct

SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
# Display P3's primaries, Bradford-adapted to D50, one colour a row.
P3_COLORANTS = (
    (0.515121, 0.241196, -0.001053),
    (0.291977, 0.692245, 0.041885),
    (0.157104, 0.066574, 0.784073),
)
REC709_COLORANTS = (
    (0.436066, 0.222488, 0.013916),
    (0.385147, 0.716873, 0.097076),
    (0.143066, 0.060608, 0.714096),
)


def _fixed(*values: float) -> bytes:
    return struct.pack(f">{len(values)}i", *(round(65536 * value) for value in values))


def parametric(kind: int, *parameters: float) -> bytes:
    return b"para" + bytes(4) + struct.pack(">HH", kind, 0) + _fixed(*parameters)


def gamma_curve(gamma: float) -> bytes:
    return b"curv" + bytes(4) + struct.pack(">IH", 1, round(gamma * 256)) + bytes(2)


def table_curve(values: list[int]) -> bytes:
    return b"curv" + bytes(4) + struct.pack(f">I{len(values)}H", len(values), *values)


def matrix_profile(
    colorants=P3_COLORANTS, curve: bytes = b"", *, name: str = "Display P3", space: bytes = b"RGB "
) -> bytes:
    curve = curve or parametric(3, *SRGB_CURVE)
    text = name.encode("utf-16-be")
    description = b"mluc" + bytes(4) + struct.pack(">II", 1, 12) + b"enUS"
    description += struct.pack(">II", len(text), 28) + text
    tags = {b"desc": description, b"wtpt": b"XYZ " + bytes(4) + _fixed(0.9642, 1.0, 0.8249)}
    for letter, colorant in zip((b"r", b"g", b"b"), colorants, strict=True):
        tags[letter + b"XYZ"] = b"XYZ " + bytes(4) + _fixed(*colorant)
        tags[letter + b"TRC"] = curve
    return _assemble(tags, space)


def table_profile(gamma: float) -> bytes:
    """Rec.709 colours with this gamma, told as a table (A2B0) and not as a matrix."""
    curve = [round(65535 * (i / 255) ** gamma) for i in range(256)]
    corners = [
        sum(bit * column[axis] for bit, column in zip(bits, REC709_COLORANTS, strict=True))
        for bits in itertools.product((0, 1), repeat=3)
        for axis in range(3)
    ]
    lut = b"mft2" + bytes(4) + bytes((3, 3, 2, 0)) + _fixed(1, 0, 0, 0, 1, 0, 0, 0, 1)
    lut += struct.pack(">HH", 256, 2) + 3 * struct.pack(">256H", *curve)
    lut += struct.pack(">24H", *(round(32768 * value) for value in corners))
    lut += 3 * struct.pack(">2H", 0, 65535)
    white = b"XYZ " + bytes(4) + _fixed(0.9642, 1.0, 0.8249)
    return _assemble({b"A2B0": lut, b"wtpt": white}, b"RGB ")


def _assemble(tags: dict[bytes, bytes], space: bytes) -> bytes:
    offset = 128 + 4 + 12 * len(tags)
    table, body = struct.pack(">I", len(tags)), b""
    for name, data in tags.items():
        data += bytes(-len(data) % 4)
        table += struct.pack(">4sII", name, offset + len(body), len(data))
        body += data
    header = struct.pack(
        ">I4sI4s4s4s", offset + len(body), b"lcms", 0x04300000, b"mntr", space, b"XYZ "
    )
    header += struct.pack(">6H4s", 2020, 1, 1, 0, 0, 0, b"acsp") + bytes(28)
    header += _fixed(0.9642, 1.0, 0.8249)
    return header.ljust(128, b"\0") + table + body
