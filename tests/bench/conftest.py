import pytest
import torch

from matcap.bench.quality import QualitySettings
from matcap.simulate.photograph import Camera


@pytest.fixture(scope="session")
def settings():
    """Small and coarse, for speed: what is tested is order, not figures."""
    return QualitySettings(
        detail=512, size=192, camera=Camera(width=512, height=384, supersampling=1)
    )


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
