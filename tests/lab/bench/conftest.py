import pytest

from matcap.lab.measures.evaluator import EvaluationSettings
from matcap.lab.simulate.photograph import PhoneCamera


@pytest.fixture(scope="session")
def settings():
    """Small and coarse, for speed: what is tested is order, not figures."""
    camera = PhoneCamera(width=512, height=384, supersampling=1)
    return EvaluationSettings(512, 192, camera, finer=2, every=1, first=1001)
