"""What training writes as it goes: curves as numbers and as a picture, and a sheet of materials."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.files.srgb import srgb_decode_tensor, srgb_picture
from matcap.lab.train.pack import Entry, Pack
from matcap.lab.train.precision import mixed
from matcap.lab.train.state import TrainConfig, TrainingState
from matcap.lab.train.step import compare, decode_windows, targets
from matcap.lab.train.training_windows import PreparedPhotograph, TrainingSample, Turn, cut
from matcap.space.prior.look import texture
from matcap.statistics.compare import Descriptor
from matcap.statistics.filterbank import FilterBank

_COLUMNS = ("step", "seconds", "style", "kl", "slope", "relit", "held_out")
_NOTED = _COLUMNS[2:-1]  # parts of the loss
_SHOWN = 6  # materials of each kind on the sheet
_SEED = 77


class Journal:
    """Curves of one run; continues those of the run it resumes."""

    def __init__(self, out: Path, step: int) -> None:
        self._out = out
        self._path = out / "curves.csv"
        self._rows: list[dict[str, float]] = []
        if step and self._path.is_file():
            with self._path.open() as file:
                self._rows = [_row(row) for row in csv.DictReader(file)]
            self._rows = [row for row in self._rows if row["step"] <= step]
        self._before = self._rows[-1]["seconds"] if self._rows else 0.0
        self._started = time.monotonic()
        self._notes: list[dict[str, float]] = []
        self.line = ""

    def note(self, step: int, parts: dict[str, float]) -> None:
        """One step's losses."""
        del step
        self._notes.append(parts)

    def report(
        self,
        state: TrainingState,
        pack: Pack,
        source: Callable[[Entry], PreparedPhotograph],
        config: TrainConfig,
        bank: FilterBank,
        device: str,
    ) -> None:
        """Measure the held-out materials and write curves and sheet."""
        seen = first_of_each(pack.training)[:_SHOWN]
        reserved = first_of_each(pack.reporting)
        rng = np.random.default_rng(_SEED)

        def window(entry: Entry, places: int) -> TrainingSample:
            return cut_plain(source(entry), config.window, places, rng).to(device)

        samples = [window(entry, config.places) for entry in reserved]
        losses, pictures = [], []
        with torch.no_grad():
            for sample in samples:
                wanted = targets([sample], bank, device)
                code = encode(state, sample, wanted[0], device)
                maps = decode_windows(state.average.decoder, code, [sample], _SEED, device)
                found, _ = compare(maps, [sample], wanted, bank, device)
                losses.append(float(torch.log1p(found)))
            shown = samples[:_SHOWN]
            shown += [window(entry, 1) for entry in seen]
            for sample in shown:
                pictures.append(_pair(state, sample, bank, device))
        row = {k: _mean([n[k] for n in self._notes if k in n]) for k in _NOTED}
        row |= {
            "step": float(state.step),
            "seconds": self._before + time.monotonic() - self._started,
            "held_out": _mean(losses),
        }
        self._notes = []
        self._rows.append(row)
        self.line = "  ".join(f"{name} {row[name]:.4g}" for name in _COLUMNS)
        with self._path.open("w", newline="") as file:
            writer = csv.DictWriter(file, _COLUMNS)
            writer.writeheader()
            writer.writerows(self._rows)
        cv2.imwrite(str(self._out / "curves.png"), plot(self._rows))
        if pictures:
            cv2.imwrite(str(self._out / "sheet.png"), np.hstack(pictures))


def _row(written: dict[str, str]) -> dict[str, float]:
    """A row of curves; what an older version did not write is unknown."""
    return {name: float(written.get(name, "nan")) for name in _COLUMNS}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def first_of_each(entries: Sequence[Entry]) -> list[Entry]:
    """The first photograph of every material."""
    first: dict[str, Entry] = {}
    for entry in entries:
        first.setdefault(entry.material, entry)
    return list(first.values())


def cut_plain(
    source: PreparedPhotograph, size: int, places: int, rng: np.random.Generator
) -> TrainingSample:
    """Windows as they lie, without turning; colours as the generator has them."""
    return cut(source, size, places, 1, Turn(), rng, augment=False)


def encode(state: TrainingState, sample: TrainingSample, wanted: Descriptor, device: str) -> Tensor:
    """(1, CODE_SIZE) mean code by the running mean's encoder."""
    with mixed(device):
        return state.average.encoder(
            sample.picture[None].to(device),
            sample.numbers[None].to(device),
            texture(wanted)[None],
        )[0]


def _pair(
    state: TrainingState, sample: TrainingSample, bank: FilterBank, device: str
) -> np.ndarray:
    """A window of a photograph above what the prior makes of it."""
    code = encode(state, sample, targets([sample], bank, device)[0], device)
    (maps,) = decode_windows(state.average.decoder, code, [sample], 7, device)
    height = maps.height[0] / sample.texel_size
    rows = [
        sample.linear[0],
        sample.render(maps)[0],
        maps.diffuse[0],
        srgb_decode_tensor(maps.roughness[0].expand(3, -1, -1)),
        (maps.specular[0].expand(3, -1, -1)) ** 0.8,
        srgb_decode_tensor((0.5 + (height - height.mean()) / 6.0).clamp(0, 1).expand(3, -1, -1)),
    ]
    return np.vstack([_shown(row) for row in rows])


def _shown(linear: Tensor) -> np.ndarray:
    code = srgb_picture(linear.cpu().numpy().transpose(1, 2, 0)[..., ::-1])
    return (code * 255.0).round().astype(np.uint8)


def plot(rows: Sequence[dict[str, float]], size: tuple[int, int] = (800, 400)) -> np.ndarray:
    """A picture of the style curves: training in blue, held-out in orange."""
    width, height = size
    canvas = np.full((height, width, 3), 255, np.uint8)
    steps = np.array([row["step"] for row in rows])
    values = {name: np.array([row[name] for row in rows]) for name in ("style", "held_out")}
    every = np.concatenate(list(values.values()))
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    span = max(high - low, 1e-6)
    for name, colour in (("style", (200, 100, 20)), ("held_out", (20, 120, 240))):
        good = np.isfinite(values[name])
        x = 50 + (width - 70) * steps[good] / max(steps.max(), 1.0)
        y = 20 + (height - 60) * (high - values[name][good]) / span
        points = np.stack([x, y], axis=1).round().astype(np.int32)
        cv2.polylines(canvas, [points], False, colour, 2, cv2.LINE_AA)
    font = cv2.FONT_HERSHEY_SIMPLEX
    for text, place in (
        (f"{high:.3f}", (2, 25)),
        (f"{low:.3f}", (2, height - 40)),
        (f"step {steps.max():.0f}   blue: training   orange: held out", (50, height - 12)),
    ):
        cv2.putText(canvas, text, place, font, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return canvas
