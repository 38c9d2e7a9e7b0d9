"""Training the prior: encoder and decoder together, as a VAE on flash photographs alone.

Each step takes a few materials. The encoder sees each whole photograph, a code is drawn, the
decoder turns fresh noise and that code into maps, and the maps are lit and seen as at several
places of the photograph and compared with what is there (statistics/compare.py). A KL term, warmed
up, keeps codes near a standard normal.

Everything random in a step follows from (seed, step), so weights, optimiser and step are the whole
state: a run killed at any time goes on from its last checkpoint as if nothing had happened.
Imports torch, numpy, cv2 and safetensors alone. Runs on the CPU and on CUDA, in bfloat16 where the
device multiplies it (precision.py).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from matcap.lab.train.checkpoint import load_checkpoint, save_checkpoint
from matcap.lab.train.corpus import true_piece
from matcap.lab.train.journal import Journal
from matcap.lab.train.pack import Entry, Pack
from matcap.lab.train.state import TrainConfig, TrainingState, start, start_from
from matcap.lab.train.step import train_step
from matcap.lab.train.training_windows import PreparedPhotograph, Turn, cut, prepare
from matcap.space.prior.look import FEATURES
from matcap.space.prior.store import Prior
from matcap.statistics.filterbank import FilterBank

_PIECE = 512  # texels a side of the true maps that windows are cut from


def train(
    pack: Pack,
    config: TrainConfig,
    out: Path,
    *,
    resume: bool = False,
    prior: Prior | None = None,
    device: str = "cpu",
    tell: Callable[[str], None] = lambda line: None,
) -> TrainingState:
    """Train until config.steps, writing checkpoints, curves and pictures into a folder.

    Begins with nothing, or with a prior's networks, or where a checkpoint in the folder ends.

    Raises:
        MatcapError: the checkpoint to resume from is missing, broken or of another shape.
    """
    state = start(config, device) if prior is None else start_from(prior, config, device)
    if resume:
        load_checkpoint(out / "checkpoint.safetensors", state)
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal(out, state.step)
    sources: dict[str, PreparedPhotograph] = {}

    def source(entry: Entry) -> PreparedPhotograph:
        if entry.name not in sources:
            truth = true_piece(entry, _PIECE) if config.relit else None
            sources[entry.name] = prepare(entry, config.encoder.width, truth)
        return sources[entry.name]

    bank = FilterBank(FEATURES)
    saved = time.monotonic()
    while state.step < config.steps:
        rng = np.random.default_rng([config.seed, state.step])
        turn = Turn(bool(rng.integers(2)), int(rng.integers(4)))
        samples = [
            cut(
                source(entry), config.window, config.places,
                2 if rng.random() < config.coarse_share else 1, turn, rng,
            )
            for entry in draw(pack.training, config, rng)
        ]  # fmt: skip
        journal.note(state.step, train_step(state, samples, config, bank, device))
        if state.step % config.report_every == 0 or state.step == config.steps:
            journal.report(state, pack, source, config, bank, device)
            tell(journal.line)
        if time.monotonic() - saved > 60.0 * config.checkpoint_minutes:
            save_checkpoint(out / "checkpoint.safetensors", state)
            saved = time.monotonic()
    save_checkpoint(out / "checkpoint.safetensors", state)
    return state


def draw(entries: Sequence[Entry], config: TrainConfig, rng: np.random.Generator) -> list[Entry]:
    """Different materials, each material as likely as another, then one photograph of each."""
    kinds: dict[bool, dict[str, list[Entry]]] = {True: {}, False: {}}
    for entry in entries:
        kinds[entry.simulated].setdefault(entry.material, []).append(entry)
    chosen: dict[str, Entry] = {}
    while len(chosen) < min(config.materials, sum(len(k) for k in kinds.values())):
        simulated = not kinds[False] or (bool(kinds[True]) and rng.random() >= config.real_share)
        materials = kinds[simulated]
        material = list(materials)[int(rng.integers(len(materials)))]
        pictures = materials[material]
        chosen[material] = pictures[int(rng.integers(len(pictures)))]
    return list(chosen.values())
