"""Capture by the paper's generator: a pretrained decoder, fine-tuned to windows of the
photographs.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from matcap.capture.exemplar.estimate import ExemplarEstimate, KnownMeans, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.rectified import FEATURES, WINDOW, Method, Rectified
from matcap.capture.result import CaptureResult, Tuning, judge_material, provenance
from matcap.capture.settings import CaptureClock, CaptureSettings, Effort
from matcap.errors import MatcapError
from matcap.field.material import Material
from matcap.files.color import srgb_encode_tensor
from matcap.files.process import postponed
from matcap.space.decoder import DecoderConfig, with_drawing
from matcap.space.freeze import Drawing
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import (
    RATE_WITH_DRAWING,
    InitialDecoder,
    Tuned,
    TuneSettings,
    finetune,
    initial_decoder,
)
from matcap.space.tuning.match import match_photograph
from matcap.space.tuning.windows import PhotographTarget, cut_windows, self_difference
from matcap.statistics.compare import Features, FilterBank

# Texture statistics of windows of photographs, the target of optimisation.


_WINDOW_STEP = 16  # texels: sides of windows are multiples of this, the decoder's alignment


def photograph_target(
    rectified: Rectified,
    settings: CaptureSettings,
    method: Method,
    most: int | None = None,
) -> PhotographTarget:
    """Windows and statistics for the texture distance.

    Args:
        rectified: the photograph, at the network's resolution.
        settings: names the statistics.
        method: has the weights.
        most: largest number of windows, or None.
    """
    plane, coarse = rectified.whole, rectified.coarse
    side = min(WINDOW, *(side // _WINDOW_STEP * _WINDOW_STEP for side in plane.size))
    bank = _features(settings)
    return PhotographTarget(
        cut_windows(plane, bank, side, most=most),
        coarse.setup,
        plane.encoding,
        bank,
        rectified.waves,
        plane.texel_size,
        weights=method.weights,
        expected=coarse.logits(),
    )


def _features(settings: CaptureSettings) -> Features:
    """Features whose statistics are compared."""
    return _STATISTICS[settings.statistics.name](settings.statistics.weights)


def _vgg19(weights: Path | None) -> Features:
    assert weights is not None
    return load_vgg19(weights)


# Constructors for the keys of settings.STATISTICS.
_STATISTICS: Mapping[str, Callable[[Path | None], Features]] = {
    "filterbank": lambda _: FilterBank(FEATURES),
    "vgg19": _vgg19,
}


# torchvision's address of the weights; the name contains the first digits of the file's SHA-256.
PUBLISHED = "https://download.pytorch.org/models/vgg19-dcbb9e9d.pth"
_DIGITS = "dcbb9e9d"
_REMEDY = f"download {PUBLISHED} and give its path"


def load_vgg19(path: Path) -> Vgg19:
    """Load VGG-19 from torchvision's .pth, or a .safetensors with the same tensor names.

    Raises:
        MatcapError: the file does not exist, has another hash, or tensors of other shapes.
    """
    network = Vgg19()
    weights = _read(path)
    wanted = network.state_dict()
    for name, value in wanted.items():
        if name not in weights or weights[name].shape != value.shape:
            raise MatcapError.at(
                path, f"this is not VGG-19: {name} is missing or of another shape", _REMEDY
            )
    network.load_state_dict({name: weights[name].float() for name in wanted})
    return network


def _read(path: Path) -> dict[str, Tensor]:
    """Tensors by name; a .pth is accepted only with the published hash."""
    if not path.is_file():
        raise MatcapError.at(path, "there are no such weights", _REMEDY)
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        with path.open("rb") as file:
            digits = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, SafetensorError) as error:
        raise MatcapError.at(path, "the weights cannot be read", _REMEDY) from error
    if not digits.startswith(_DIGITS):
        raise MatcapError.at(
            path,
            f"this is not the published file: its SHA-256 begins with {digits[:8]}, not {_DIGITS}",
            _REMEDY,
        )
    # Tensors alone: nothing in the file is executed.
    weights: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    return weights


# Output channels of the convolutions, "M" for max-pooling (configuration E), up to the last used.
_LAYERS: tuple[int | str, ...] = (
    64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512, 512, 512, "M", 512,
)  # fmt: skip
_USED = (0, 2, 4, 8, 12)  # indices of convolutions: the first of each block
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, in code values


class Vgg19(nn.Module):
    """VGG-19 features [simonyan2015], as [henzler2021]; compare.Features in place of a FilterBank.

    The rectified first convolution of each of five blocks [gatys2015], of the sRGB-encoded image.
    The weights are not distributed with matcap: the user's file in torchvision's form is read.

    Attributes:
        levels: of the colour pyramid, whose spectra and quantiles are in the descriptor, too.
        crossed: False, as in the paper: deep features span several scales.
    """

    crossed = False

    def __init__(self, levels: int = 4) -> None:
        super().__init__()
        self.levels = levels
        layers: list[nn.Module] = []
        channels = 3
        for layer in _LAYERS:
            if isinstance(layer, str):
                layers.append(nn.MaxPool2d(2))
                continue
            layers += [nn.Conv2d(channels, layer, 3, padding=1), nn.ReLU()]
            channels = layer
        self.features = nn.Sequential(*layers)
        self.requires_grad_(False)

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """Five rectified responses, (B, C, H / 2^k, W / 2^k), of radiance (B, 3, H, W).

        Zero padding affects the outermost few texels of every layer.
        """
        del colours  # the network has its own pyramid
        mean, deviation = (
            torch.tensor(v, dtype=linear.dtype)[:, None, None] for v in (_MEAN, _DEVIATION)
        )
        features = ((srgb_encode_tensor(linear.clamp(0.0, 1.0)) - mean) / deviation).contiguous(
            memory_format=torch.channels_last
        )
        activations, convolution = [], -1
        for layer in self.features:
            features = layer(features)
            if isinstance(layer, nn.Conv2d):
                convolution += 1
            elif isinstance(layer, nn.ReLU) and convolution in _USED:
                activations.append(features)
        return activations


# Capture by the paper's generator: a pretrained decoder, fine-tuned to the photograph
# [henzler2021, sec. 4.6].
#
# Beyond the paper the decoder reads a drawing (space/freeze.py) of the exemplar, which is
# estimated first, as by default. Stages: those of estimate_exemplar, statistics, start,
# fine-tuning, matching, verdict.


def capture_by_decoder(
    rectified: Rectified,
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
    clock: CaptureClock,
) -> CaptureResult:
    """Capture a photograph as a fine-tuned decoder.

    Args:
        rectified: the photograph, at the network's resolution.
        settings: of the user.
        effort: steps and windows that follow from the settings.
        method: variant of the method.
        clock: of the capture.

    Raises:
        MatcapError: the prior cannot be read.
    """
    photo, coarse, plane = rectified.photo, rectified.coarse, rectified.whole

    def estimated(clock: CaptureClock) -> ExemplarEstimate:  # at the coarse fit's exposure
        return estimate_exemplar(rectified, load_inverse(), clock, KnownMeans(absolute=True))

    estimate = estimated(clock) if settings.draws else None
    with clock.stage("statistics"):
        most = None if effort.steps else 1
        target = photograph_target(rectified, settings, method, most)
        drawing = None if estimate is None else Drawing(estimate.example)
        if drawing is not None:  # it shows the lattice already, with the exemplar's phases
            target = replace(target, waves=())
        window_distance = self_difference(target.windows, target.weights)
        tune = TuneSettings(
            steps=effort.steps,
            places=effort.places,
            seed=settings.seed,
        )
    start = _start(rectified, settings, target, tune, clock)
    target = replace(target, drawing=drawing)
    decoder, tuned = tuned_decoder(plane.texel_size, start, target, tune, clock, window_distance)
    about = provenance(rectified, settings, effort, [])
    material = decoder.material(photo.stem, coarse.setup, about)
    if tuned.history and effort.matched:
        with clock.stage("matching"), postponed() as stopped:
            material = match_photograph(material, plane, settings.seed)
        clock.interrupted |= bool(stopped())

    if estimate is None and settings.aligned:
        with postponed() as stopped:
            estimate = estimated(CaptureClock(None))
        clock.interrupted |= bool(stopped())
    went = Tuning(tuned.history, window_distance, drawing is not None)
    if photo.turned:  # all above is in landscape format
        material = _upright(material)
        estimate = estimate and estimate.upright(rectified.waves)
    return judge_material(rectified, material, settings, clock, estimate, went)


def _start(
    rectified: Rectified,
    settings: CaptureSettings,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
) -> InitialDecoder:
    """The prior's decoder, or a random one; it reads no drawing."""
    with clock.stage("start"):
        return initial_decoder(
            rectified.photo.developed(rectified.photo.pixels),  # as the encoder was trained on
            rectified.coarse,
            rectified.whole,
            target,
            tune,
            settings.prior,
            DecoderConfig(),
        )


def tuned_decoder(
    texel_size: float,
    start: InitialDecoder,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
    window_distance: float,
) -> tuple[TunedDecoder, Tuned]:
    """Fine-tune a decoder, with a drawing among its inputs if the target has one.

    Its texels have a side of `texel_size` plane units; `window_distance` is the unit of the errors
    that the clock reports. A start that reads a drawing has its own rate.
    """
    decoder, rate = start.decoder, start.rate
    if target.drawing is not None and not decoder.config.drawing:
        decoder, rate = with_drawing(decoder), RATE_WITH_DRAWING
    with clock.stage("fine-tuning"):
        limit, unit = clock.left_for("fine-tuning"), window_distance or math.nan
        seconds = limit if math.isfinite(limit) else None
        tune = replace(tune, seconds=seconds, learning_rate=rate)
        tuned = finetune(
            decoder,
            start.code,
            target,
            tune,
            lambda share, error, taken: clock.tuning(share, error / unit),
        )
    clock.interrupted |= tuned.interrupted
    network = tuned.decoder.eval().requires_grad_(False)
    made = TunedDecoder(
        network, start.code, tuned.moments, target.waves, texel_size, target.drawing
    )
    return made, tuned


def _upright(material: Material) -> Material:
    """A decoder's material with its field rotated to a portrait."""
    tuned, setup = material.part(TunedDecoder), replace(material.setup, turned=True)
    assert tuned is not None
    return tuned.material(material.name, setup, material.provenance)
