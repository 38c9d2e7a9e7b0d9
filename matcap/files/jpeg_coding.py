"""Detects JPEG coding modes that common decoders do not support (ITU-T T.81, table B.1)."""

from __future__ import annotations

from pathlib import Path

_LOSSLESS_OR_HIERARCHICAL = (0xC3, 0xC5, 0xC6, 0xC7, 0xCB, 0xCD, 0xCE, 0xCF)


def unsupported_jpeg(path: Path) -> str:
    """The coding mode, such as "JPEG of 12 bits", if it is not supported; else ""."""
    with path.open("rb") as file:
        file.seek(2)
        while len(marker := file.read(2)) == 2:
            if marker[0] != 0xFF or marker[1] == 0xDA:
                return ""
            if marker[1] == 0xFF:  # a fill byte
                file.seek(-1, 1)
                continue
            if marker[1] in range(0xC0, 0xD0) and marker[1] not in (0xC4, 0xC8, 0xCC):
                bits = file.read(3)[-1:]
                if marker[1] in _LOSSLESS_OR_HIERARCHICAL:
                    return "lossless or hierarchical JPEG"
                return f"JPEG of {bits[0]} bits" if bits and bits[0] != 8 else ""
            length = int.from_bytes(file.read(2), "big")
            file.seek(max(length - 2, 0), 1)
    return ""
