"""What is said to a network is refused where there is none."""

from dataclasses import replace

import pytest
from exemplars import an_example
from materials import a_material

from matcap.errors import UsageError
from matcap.field.options import ReadOptions
from matcap.space.patch import Rectangle
from matcap.synth.fields import open_field
from matcap.synth.request import SynthRequest


@pytest.fixture
def path(tmp_path):
    """A material of both generators."""
    a_material("blobs", example=an_example()).save(tmp_path / "blobs.matcap")
    return tmp_path / "blobs.matcap"


@pytest.mark.parametrize(
    ("option", "given"),
    [
        ("--precision", {"precision": "bf16"}),
        ("--precision", {"precision": "auto"}),
        ("--device", {"device": "cuda"}),
    ],
)
def test_a_rearranged_piece_has_no_precision_and_no_device(path, option, given):
    with pytest.raises(UsageError, match=f"{option}: only the decoder"):
        open_field(SynthRequest(path, Rectangle(0, 0, 8, 8), **given))


def test_a_network_has_both_and_what_changes_nothing_is_not_refused(path):
    asked = SynthRequest(path, Rectangle(0, 0, 8, 8), device="cpu")
    open_field(asked)
    network = ReadOptions(generator="decoder")
    assert open_field(replace(asked, precision="auto", read=network))[1].choice is not None
