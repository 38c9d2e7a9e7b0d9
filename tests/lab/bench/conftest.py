import pytest

from matcap.lab.bench.quality import QualitySettings
from matcap.lab.simulate.photograph import PhoneCamera


@pytest.fixture(scope="session")
def settings():
    """Small and coarse, for speed: what is tested is order, not figures."""
    return QualitySettings(
        detail=512, size=192, camera=PhoneCamera(width=512, height=384, supersampling=1)
    )
