"""State of training a prior: settings, networks and their initialisation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from matcap.errors import UsageError
from matcap.space.decoder import OUTPUTS, Decoder, DecoderConfig
from matcap.space.encoder import Encoder, EncoderConfig
from matcap.space.prior.store import Prior
from matcap_lab.train.trainer import Training

_START = (1.0, 1.0, 1.0, 0.33, 0.33, 0.33)  # deviations of an untrained head's outputs


@dataclass(frozen=True)
class TrainConfig:
    """Settings of training a prior; a TOML file has the same names (cli/prior.py)."""

    steps: int = 6000
    """Number of steps; the learning rate falls to nothing over the last quarter."""
    materials: int = 4
    """Photographs of different materials in a step."""
    places: int = 2
    """Windows of each photograph."""
    window: int = 160
    """Texels a side, MARGIN short of a multiple of 16 on either side."""
    real_share: float = 0.65
    """Share of real photographs."""
    coarse_share: float = 0.15
    """Share of photographs used at half the resolution."""
    rate: float = 2e-3
    encoder_rate: float = 5e-4
    """Learning rates of AdamW, of decoder and encoder."""
    weight_decay: float = 1e-5
    """Weight decay of AdamW."""
    kl: float = 0.03
    """Weight of the KL term, per dimension of the code."""
    kl_warmup: int = 1000
    """Steps until the KL term counts in full."""
    slope: float = 0.02
    """Weight of the mean squared slope, and of slopes too steep or too fine (step.py)."""
    relit: float = 0.0
    """Weight of the second teacher (step.py); 0 leaves it out."""
    average: float = 0.998
    """Decay of the running mean of the weights, which is what is shipped."""
    seed: int = 1
    """Seed of all random numbers."""
    checkpoint_minutes: float = 4.0
    """Minutes between checkpoints."""
    report_every: int = 250
    """Steps between reports on the held-out materials."""
    encoder: EncoderConfig = EncoderConfig()
    decoder: DecoderConfig = DecoderConfig()
    """Shapes of encoder and decoder."""


def start_head(decoder: Decoder) -> None:
    """Initialise an untrained head to output zero mean and the deviations _START."""
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.mul_(0.2)
        affine.bias.copy_(torch.cat([torch.zeros(OUTPUTS), torch.tensor(_START)]))


class Model(nn.Module):
    """Encoder and decoder."""

    def __init__(self, encoder: EncoderConfig, decoder: DecoderConfig) -> None:
        super().__init__()
        self.encoder = Encoder(encoder)
        self.decoder = Decoder(decoder)
        start_head(self.decoder)


def start(config: TrainConfig, device: str) -> Training[Model]:
    """An untrained state."""
    torch.manual_seed(config.seed)
    model = Model(config.encoder, config.decoder)
    model.to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    rates = {"encoder.": config.encoder_rate, "decoder.": config.rate}
    return Training(model, rates, decay=config.average, weight_decay=config.weight_decay)


def start_from(prior: Prior, config: TrainConfig, device: str) -> Training[Model]:
    """A state with a prior's networks and a new optimiser.

    Raises:
        UsageError: its networks are of other shapes than the configuration's.
    """
    state = start(config, device)
    for name, network, shape in (
        ("encoder", prior.encoder, config.encoder),
        ("decoder", prior.decoder, config.decoder),
    ):
        if network.config != shape:
            raise UsageError.at(
                "--start",
                f"the prior's {name} is of another shape than [{name}] of the settings",
                "give the settings it was trained with",
            )
        for model in (state.model, state.average):
            getattr(model, name).load_state_dict(network.state_dict())
    return state
