"""Training of the decoder that reads drawings: what it writes is what captures start from."""

import torch
from safetensors.torch import load_file

from matcap.space.prior import store
from matcap_lab.train.drawing import known, train


def test_what_is_written_is_loaded_and_has_learnt_to_read(tmp_path, monkeypatch):
    torch.set_num_threads(1)
    path = tmp_path / "drawing.safetensors"
    train([known(None, 3)], 4.0, path)
    monkeypatch.setattr(store, "DRAWING_START", path)
    decoder = store.load_drawing_start()
    assert {k: v.shape for k, v in load_file(path).items()} == {
        k: v.shape for k, v in decoder.state_dict().items()
    }
    moved = [float(weights.abs().mean()) for weights in decoder.drawing_weights()]
    assert all(0.0 < size < 1.0 for size in moved)
    before = dict(store.load_prior().decoder.named_parameters())["head.convolution.weight"]
    assert not torch.equal(before.half().float(), decoder.head.convolution.weight)
