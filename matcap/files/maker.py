"""The generator mark that every file written by matcap carries."""

from __future__ import annotations

from matcap.version import __version__

MAKER_VERSION = __version__
MAKER = f"matcap {MAKER_VERSION}"
SOFTWARE = "Software"  # name of the entry in PNG and EXR files
