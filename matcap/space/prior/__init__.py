"""The prior over materials [henzler2021]: its file, its shipped weights, and draws from it."""

from pathlib import Path

SHIPPED = Path(__file__).parent / "weights" / "prior.safetensors"
