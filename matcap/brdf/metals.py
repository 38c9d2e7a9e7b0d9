"""F0 of clean metals at normal incidence, linear Rec.709.

From measured refractive indices [lagarde2011]; [akenine2018, table 9.2] agrees within a few
hundredths. Brass is an alloy, of which tables differ by as much. Steel is iron.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

METAL_F0: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "gold": (1.000, 0.766, 0.336),
        "copper": (0.955, 0.638, 0.538),
        "brass": (0.887, 0.789, 0.434),
        "aluminium": (0.913, 0.922, 0.924),
        "steel": (0.56, 0.57, 0.58),
    }
)
