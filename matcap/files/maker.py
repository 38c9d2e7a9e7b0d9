"""The generator mark that every file written by matcap carries."""

from __future__ import annotations

MAKER_VERSION = "0.1.0"  # of matcap
MAKER = f"matcap {MAKER_VERSION}"
