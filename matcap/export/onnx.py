"""The frozen network of a material as an ONNX file, for other programs (extra `onnx`).

What is in the file is all that decodes a material: convolutions with AdaIN folded in, poolings,
doublings and the sigmoids. The random field is not: whoever runs it gives noise, uniform with mean
0 and variance 1, and, for a material with a regular order, the phases of its waves per level.

Borders are padded with zeros: cut `halo` texels (in the file's metadata) off every side.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import CHANNELS
from matcap.errors import MatcapError
from matcap.field.material import lacking
from matcap.field.plane import Rectangle, Span
from matcap.files.staging import staged_file
from matcap.space.decoder import DEPTH, OUTPUTS, maps_from_raw
from matcap.space.freeze import FoldedDecoder, FoldedLayer
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, random_field
from matcap.space.regular_order import WAVE_CHANNELS
from matcap.space.spans import spans_of
from matcap.space.tuned import TunedDecoder

if TYPE_CHECKING:
    from matcap.field.material import Material

_OPSET = 17
_IR_VERSION = 8  # what onnxruntime has read since 2022
_CHECKED = (160, 96)  # texels: width and height of the field that is compared
_TOLERANCE = 1e-4


def write_onnx(material: Material, path: str | Path) -> float:
    """Write a material's network and compare it with torch; returns the largest difference.

    Inputs: `noise` (1, noise channels, H, W) and, where the material has waves, `waves_0` to
    `waves_3` (1, 12, H / 2^k, W / 2^k); H and W multiples of 16. Outputs: `diffuse`, `specular`,
    `roughness` and `height` (1, C, H, W), as in a MapSet.

    Raises:
        UsageError: the material has no decoder.
        MatcapError: the extra is missing, the file cannot be written, or onnxruntime's maps
            differ by more than 1e-4.
    """
    onnx, runtime = _need("onnx"), _need("onnxruntime")
    path = Path(path)
    tuned = material.part(TunedDecoder)
    if tuned is None:
        raise lacking("decoder")
    model = _model(onnx, material.name, tuned).SerializeToString()
    error = _difference(runtime, model, tuned)
    if not error <= _TOLERANCE:
        raise MatcapError(f"onnxruntime's maps differ by {error:g}", where=str(path))
    with staged_file(path) as file:
        file.write_bytes(model)
    return error


def _need(name: str) -> Any:  # noqa: ANN401
    try:
        return import_module(name)
    except ImportError as error:
        raise MatcapError(
            "ONNX files need onnx and onnxruntime", remedy='pip install "matcap[onnx]"'
        ) from error


class _Graph:
    """Nodes and weights of a graph that grows; names are given in running order."""

    def __init__(self, onnx: Any) -> None:  # noqa: ANN401
        self.helper = onnx.helper
        self._from_array = onnx.numpy_helper.from_array
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def constant(self, values: Tensor) -> str:
        """A weight; returns its name."""
        name = f"weight_{len(self.weights)}"
        array = np.ascontiguousarray(values.detach().numpy())
        self.weights.append(self._from_array(array, name))
        return name

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:  # noqa: ANN401
        """A node; returns its output's name."""
        output = output or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(self.helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def layer(self, layer: FoldedLayer, features: str) -> str:
        """A folded convolution."""
        weight = torch.cat(layer.weights, dim=1)
        pads = [weight.shape[-1] // 2] * 4
        parts = (features, self.constant(weight), self.constant(layer.bias))
        features = self.add("Conv", *parts, pads=pads, kernel_shape=list(weight.shape[2:]))
        return self.add("Relu", features) if layer.activate else features


def _model(onnx: Any, name: str, material: TunedDecoder) -> Any:  # noqa: ANN401
    graph, decoder = _Graph(onnx), material.folded()
    raw = _network(graph, decoder)
    sizes = graph.constant(torch.tensor(list(CHANNELS.values())))
    graph.nodes.append(
        graph.helper.make_node("Split", [raw, sizes], [f"raw_{kind}" for kind in CHANNELS], axis=1)
    )
    for kind in CHANNELS:
        if kind == "height":
            texel = graph.constant(torch.tensor(material.texel_size))
            graph.add("Mul", "raw_height", texel, output="height")
        else:
            graph.add("Sigmoid", f"raw_{kind}", output=kind)
    inputs = {"noise": (decoder.noise_channels + decoder.grains, 0)}
    if decoder.has_waves:
        inputs |= {
            f"waves_{level}": (WAVE_CHANNELS + decoder.cells, level) for level in range(DEPTH)
        }
    real = onnx.TensorProto.FLOAT

    def described(of: str, channels: int, level: int) -> Any:  # noqa: ANN401
        shape = [1, channels, f"height_{level}", f"width_{level}"]
        return graph.helper.make_tensor_value_info(of, real, shape)

    model = graph.helper.make_model(
        graph.helper.make_graph(
            graph.nodes,
            name,
            [described(of, *shape) for of, shape in inputs.items()],
            [described(kind, channels, 0) for kind, channels in CHANNELS.items()],
            graph.weights,
        ),
        opset_imports=[graph.helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="matcap",
    )
    told = {"halo": str(_halo(decoder)), "texel_size": repr(material.texel_size)}
    graph.helper.set_model_props(model, told)
    onnx.checker.check_model(model, full_check=True)
    return model


def _network(graph: _Graph, decoder: FoldedDecoder) -> str:
    """The wiring of FoldedDecoder.__call__; returns the raw outputs' name."""
    features, skips = "noise", []
    for level, block in enumerate(decoder.down):
        if level > 0:
            features = graph.add("MaxPool", features, kernel_shape=[2, 2], strides=[2, 2])
        for layer in block:
            features = graph.layer(layer, features)
        skips.append(features)
    scales = graph.constant(torch.tensor([1.0, 1.0, 2.0, 2.0]))
    for level, block in zip(reversed(range(DEPTH)), decoder.up, strict=True):
        doubled = graph.add(
            "Resize", features, "", scales,
            mode="linear", coordinate_transformation_mode="half_pixel",
        )  # fmt: skip
        waves = [f"waves_{level}"] if decoder.has_waves else []
        features = graph.add("Concat", doubled, skips[level], *waves, axis=1)
        for layer in block:
            features = graph.layer(layer, features)
    return graph.layer(decoder.head, features)


def _halo(decoder: FoldedDecoder) -> int:
    """Texels at every border that padding reaches."""
    return -spans_of(Span(0, 16), decoder.convolutions).down[0].start


def _difference(runtime: Any, model: bytes, material: TunedDecoder) -> float:  # noqa: ANN401
    """Largest difference between onnxruntime's and torch's maps of one field."""
    decoder = material.folded()
    field = random_field(
        Patch(1, Rectangle(0, 0, *_CHECKED)),
        decoder.noise_channels,
        material.waves,
        levels=DEPTH,
        cells=decoder.cells,
        grains=decoder.grains,
    )
    session = runtime.InferenceSession(model, providers=["CPUExecutionProvider"])
    given = {"noise": field.noise.numpy()}
    if decoder.has_waves:
        given |= {f"waves_{level}": waves.numpy() for level, waves in enumerate(field.waves)}
    given = {name: np.ascontiguousarray(values) for name, values in given.items()}
    found = np.concatenate(session.run(list(CHANNELS), given), axis=1)
    with torch.inference_mode():
        raw = decoder(RandomField(field.noise, field.waves))
        expected = maps_from_raw(raw, material.texel_size).stacked().numpy()
    assert found.shape[1] == OUTPUTS
    return float(np.abs(found - expected).max())
