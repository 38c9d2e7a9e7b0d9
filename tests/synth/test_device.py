"""One device or the other: chosen, refused, never mixed. What needs CUDA is skipped without it."""

from dataclasses import replace

import pytest
import torch
from test_stream import ODD, contents, request

from matcap.errors import MatcapError, UsageError
from matcap.field.device import find_device, repeatable
from matcap.field.field import Field
from matcap.field.plane import Rectangle
from matcap.space.source import DecoderSource
from matcap.synth.request import Work
from matcap.synth.stream import write_field

CONVOLUTION = torch.backends.cudnn.conv
needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")


class OnCuda(DecoderSource):
    """Says that it is on CUDA, for what only asks."""

    device = torch.device("cuda")


def claimed(asked):
    """A request whose source says so."""
    request, field = asked
    return request, replace(field, source=OnCuda(**vars(field.source)))


@pytest.mark.parametrize(
    ("name", "there", "found"),
    [("auto", True, "cuda"), ("auto", False, "cpu"), ("cpu", True, "cpu"), ("cuda", True, "cuda")],
)
def test_the_device_is_what_was_asked_for_and_is_there(monkeypatch, name, there, found):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    assert find_device(name) == torch.device(found)


def test_cuda_that_is_not_there_is_refused(material, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match="sees no CUDA device; use cpu, or"):
        Field(material, device="cuda")
    assert Field(material, device="auto").source.device.type == "cpu"


def test_the_processor_again_is_the_same_bits(wavy):
    source = wavy.generator.source(1)
    moved = replace(source, decoder=source.decoder.to(torch.device("cpu")))
    block = Rectangle(-512, 256, 64, 32)
    assert torch.equal(source.maps(block), moved.maps(block))


def test_nothing_of_a_block_is_left_on_the_processor(wavy):
    """A device without memory stands for CUDA: it refuses operands that lie elsewhere."""
    source = wavy.generator.source(1, device=torch.device("meta"))
    maps = source.maps(Rectangle(0, 0, 64, 32))
    assert (maps.device.type, maps.shape, maps.dtype) == ("meta", (6, 34, 66), torch.float32)


@pytest.mark.parametrize("everything", ["none", "tf32"])
def test_convolutions_are_exact_for_a_while(monkeypatch, everything):
    """Also where the process wants TF32 everywhere."""
    monkeypatch.setattr(torch.backends, "fp32_precision", everything)
    before = CONVOLUTION.fp32_precision
    with pytest.raises(KeyError), repeatable(torch.device("cuda")):
        assert CONVOLUTION.fp32_precision == "ieee"
        assert torch.backends.cudnn.deterministic
        raise KeyError
    assert CONVOLUTION.fp32_precision == before == "tf32"
    assert not torch.backends.cudnn.deterministic
    with repeatable(torch.device("cpu")):
        assert CONVOLUTION.fp32_precision == before


def test_a_run_is_not_resumed_on_another_device(material, tmp_path):
    def full(_now):
        raise OSError(28, "No space left on device")

    with pytest.raises(MatcapError, match="full"):
        write_field(*request(material), tmp_path, Work(progress=full))
    with pytest.raises(MatcapError, match="begun on cpu; cuda rounds differently; give --device"):
        write_field(*claimed(request(material)), tmp_path, Work(resume=True))
    # The refusal took nothing away.
    write_field(*request(material), tmp_path, Work(resume=True))
    write_field(*request(material), tmp_path / "whole")
    assert contents(tmp_path) == contents(tmp_path / "whole")


def test_a_cluster_is_not_sent_to_cuda(material, tmp_path):
    with pytest.raises(UsageError, match="CPUs"):
        write_field(*claimed(request(material)), tmp_path, Work(scheduler="tcp://127.0.0.1:9"))


@needs_cuda
def test_cuda_gives_the_processors_maps(wavy):
    area = (-200, 100, 700, 300)
    here, there = (Field(wavy, 3, device=name).read(*area) for name in ("cpu", "cuda"))
    assert there.height.device.type == "cpu"
    for kind in ("diffuse", "specular", "roughness"):
        assert float((getattr(here, kind) - getattr(there, kind)).abs().max()) < 1e-4
    assert float((here.height - there.height).abs().max()) < 1e-4 * float(here.height.std())


@needs_cuda
def test_cuda_repeats_its_bits_whatever_is_asked_for(wavy):
    field = Field(wavy, 3, device="cuda")
    whole = field.read(-200, 100, 700, 300, workers=3).stacked()
    part = field.read(-50, 190, 170, 100, workers=1).stacked()
    assert torch.equal(part, whole[:, 90:190, 150:320])


@needs_cuda
def test_workers_change_no_byte_on_cuda(material, tmp_path):
    asked, field = request(material, ODD)
    source = replace(field.source, decoder=field.source.decoder.to(torch.device("cuda")))
    for workers in (1, 3):
        write_field(asked, replace(field, source=source), tmp_path / str(workers), Work(workers))
    assert contents(tmp_path / "1") == contents(tmp_path / "3")
