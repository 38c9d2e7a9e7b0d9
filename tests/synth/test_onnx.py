"""The exported network computes what torch computes."""

import pytest

from matcap.errors import MatcapError
from matcap.export.onnx import write_onnx
from matcap.space.tuned import TunedDecoder

onnx = pytest.importorskip("onnx", reason="needs the extra `onnx`")
pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")


def test_onnxruntime_gives_the_same_maps(material, wavy, tmp_path):
    for one in (material, wavy):
        path = tmp_path / f"{one.name}.onnx"
        assert write_onnx(one, path) < 1e-5
        model = onnx.load(path)
        names = [given.name for given in model.graph.input]
        assert names == [
            "noise",
            *([f"waves_{k}" for k in range(4)] if one.part(TunedDecoder).waves else []),
        ]
        assert [out.name for out in model.graph.output] == [
            "diffuse", "specular", "roughness", "height",
        ]  # fmt: skip
    assert sorted(file.name for file in tmp_path.iterdir()) == ["tiny.onnx", "wavy.onnx"]


def test_an_unwritable_place_is_said(material, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(MatcapError, match="file: a file stands where a folder is needed"):
        write_onnx(material, tmp_path / "file" / "m.onnx")


def test_a_network_that_differs_is_refused(material, tmp_path, monkeypatch):
    from matcap.export import onnx as module

    monkeypatch.setattr(module, "_difference", lambda *_: float("nan"))
    with pytest.raises(MatcapError, match="differ by nan"):
        write_onnx(material, tmp_path / "m.onnx")
    assert list(tmp_path.iterdir()) == []
