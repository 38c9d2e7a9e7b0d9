"""What is said to a network is refused where there is none."""

from dataclasses import replace

import pytest
from exemplars import an_example
from materials import a_material

from matcap.errors import UsageError
from matcap.space.random_field import Rectangle
from matcap.synth.plan import open_field
from matcap.synth.request import SynthRequest


@pytest.fixture
def path(tmp_path):
    """A material of both generators."""
    a_material("blobs", example=an_example()).save(tmp_path / "blobs.matcap")
    return tmp_path / "blobs.matcap"


def test_a_field_by_example_refuses_cuda_and_accepts_the_cpu(path):
    asked = SynthRequest(path, Rectangle(0, 0, 8, 8), device="cpu")
    open_field(asked)
    with pytest.raises(UsageError, match="--device: only the decoder"):
        open_field(replace(asked, device="cuda"))
