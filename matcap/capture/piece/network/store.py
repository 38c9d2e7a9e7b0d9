"""File of the inverse network: weights in half precision, and a model card."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open

from matcap.capture.piece.network.network import Inverse, InverseConfig
from matcap.errors import MatcapError

FORMAT = "matcap-inverse"
VERSION = 2  # of the file
SHIPPED = Path(__file__).parent / "weights" / "inverse.safetensors"
_WIDEST, _DEEPEST = 512, 8
_REMEDY = "install matcap again, or give another file"


def read_inverse(path: Path) -> tuple[Inverse, dict[str, Any]]:
    """Read a network and its model card.

    Raises:
        MatcapError: the file is missing, damaged, or of another format or version.
    """
    try:
        with safe_open(path, framework="pt") as file:
            about = json.loads((file.metadata() or {})["matcap"])
            if about["format"] != FORMAT or about["version"] != VERSION:
                raise ValueError(f"it holds {about['format']} of version {about['version']}")
            widths = tuple(int(width) for width in about["widths"])
            sizes = (*widths, int(about["context"]))
            if not (2 <= len(widths) <= _DEEPEST and all(4 <= s <= _WIDEST for s in sizes)):
                raise ValueError(f"a network of widths {sizes}")
            network = Inverse(InverseConfig(widths, int(about["context"])))
            state = {}
            for name, expected in network.state_dict().items():
                value = file.get_tensor(name).float()
                if value.shape != expected.shape or not bool(torch.isfinite(value).all()):
                    raise ValueError(f"the tensor {name} is not as it should be")
                state[name] = value
            network.load_state_dict(state)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise MatcapError.at(
            path, f"this is not an inverse network's file, or it is damaged ({error})", _REMEDY
        ) from error
    network = network.eval().requires_grad_(False)
    return network, dict(about["card"])


@cache
def load_inverse() -> Inverse:
    """Load the network that comes with matcap, once per process."""
    return read_inverse(SHIPPED)[0]
