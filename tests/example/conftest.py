"""Small materials, and examples of a test's parameters."""

import pytest
from materials import a_material, make_material, material, wavy  # noqa: F401
from random_maps import maps  # noqa: F401
from small import prior  # noqa: F401


@pytest.fixture
def example(request):
    """What a parameter makes: only here, as every process collects all tests."""
    return request.param()
