"""The decoder: a U-Net that turns an infinite random field into maps (paper, section 4.2).

Noise enters at full resolution, is halved by max-pooling four times and doubled back by bilinear
upsampling with skip connections. On the way up every level also receives the material's regular
order, if it has any (regular_order.py); on the way down, waves would beat with the poolings' grid.

Every convolution is followed by AdaIN [huang2017], whose mean and deviation are
affine in the 64-D code; also the last one, so the code states each map's mean and contrast
outright. AdaIN's own statistics come either from the rectangle at hand (training) or from a large
reference field (frozen; see freeze.py).

Nothing here invents data at a border: a rectangle is decoded either as a torus (`periodic=True`,
a field that repeats with the rectangle) or with a halo of true noise, whose border is cut off by
the caller (field/field.py).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from matcap.brdf.maps import MapSet
from matcap.space.random_field import RandomField
from matcap.space.regular_order import WAVE_CHANNELS
from matcap.space.wrap import wrap

CODE_SIZE = 64  # numbers; the paper's
OUTPUTS = 6  # diffuse (3), specular, roughness, height
DEPTH = 4  # poolings; rectangles are multiples of 2^DEPTH
ALIGNMENT = 2**DEPTH  # texels: what sides and periods are multiples of
_ORDER_GAIN = 3.0  # waves and cells are few among many features; they start with a fair say
_EPSILON = 1e-5  # of a variance: keeps a constant feature finite


@dataclass(frozen=True)
class DecoderConfig:
    """What shape a decoder has."""

    noise_channels: int = 8
    """Channels of uniform noise read at full resolution."""
    widths: tuple[int, ...] = (16, 32, 64, 64, 64)
    """Feature channels per level, full resolution first; DEPTH + 1 of them."""
    convolutions: tuple[int, int] = (1, 2)
    """3 x 3 convolutions per block on the way down and on the way up."""
    cells: int = 0
    """Channels of noise for the cells of regular order (regular_order.py), for materials that have
    any."""
    grains: int = 0
    """Channels of structured noise (structured_noise.py), besides the white; 0 for none."""

    @property
    def inputs(self) -> int:
        """What the way down reads at full resolution."""
        return self.noise_channels + self.grains

    @property
    def order_channels(self) -> int:
        """What the way up reads at every level besides features."""
        return WAVE_CHANNELS + self.cells


# The paper's shape at width 32; 2.2 million parameters.
PAPER_CONFIG = DecoderConfig(noise_channels=6, widths=(32, 64, 128, 128, 128), convolutions=(2, 2))

Moments = tuple[Tensor, Tensor]  # mean and deviation, (channels,) each


class AdaIN(nn.Module):
    """Adaptive instance normalisation: the code states each channel's mean and deviation."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.affine = nn.Linear(CODE_SIZE, 2 * channels)
        _draw(self.affine.weight, 0.05)
        nn.init.zeros_(self.affine.bias)
        self.affine.bias.data[channels:] = 1.0

    def target(self, code: Tensor) -> Moments:
        """Mean and deviation that a code (CODE_SIZE,) asks for."""
        mean, deviation = self.affine(code).chunk(2, dim=-1)
        return mean, deviation

    def affine_of(self, code: Tensor, moments: Moments) -> Moments:
        """Scale and shift that normalise by `moments` and move to the code's targets."""
        mean, deviation = moments
        wanted_mean, wanted_deviation = self.target(code)
        scale = wanted_deviation / deviation
        return scale, wanted_mean - mean * scale

    def forward(self, features: Tensor, code: Tensor, moments: Moments | None) -> Tensor:
        """Move (B, C, H, W) to the code's mean and deviation.

        The batch is one material and shares its statistics; without `moments` they are those of
        the features themselves. PyTorch's fused batch normalisation is the same arithmetic, eight
        times as fast as its separate steps.
        """
        exact = torch.promote_types(features.dtype, torch.float32)
        mean, deviation = (target.to(exact) for target in self.target(code))
        own = variance = None
        if moments is not None:
            own, variance = moments[0], moments[1].square() - _EPSILON
        return F.batch_norm(
            features, own, variance, deviation, mean, moments is None, 0.0, _EPSILON
        )

    def measured(self, features: Tensor, code: Tensor) -> tuple[Tensor, Moments]:
        """Features (B, C, H, W) moved as without moments, and the moments (C,), in float32."""
        mean, deviation = (target.float() for target in self.target(code))
        adapted, own, inverse = torch.native_batch_norm(
            features.float(), deviation, mean, None, None, True, 0.0, _EPSILON
        )
        return adapted, (own, inverse.reciprocal())


class ConvolutionLayer(nn.Module):
    """Convolution, AdaIN, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, activate: bool = True) -> None:
        super().__init__()
        # AdaIN takes the mean away, so a bias would do nothing.
        self.convolution = nn.Conv2d(inputs, outputs, kernel, bias=False)
        _draw(self.convolution.weight, math.sqrt(2.0 / (inputs * kernel * kernel)))
        # The layout in which the processor's convolutions run fastest.
        weight = self.convolution.weight.data.contiguous(memory_format=torch.channels_last)
        self.convolution.weight.data = weight
        self.adain = AdaIN(outputs)
        self.activate = activate

    def convolve(self, features: Tensor, periodic: bool) -> Tensor:
        """The convolution alone, same size out as in."""
        kernel = self.convolution.weight.shape[-1]
        if kernel == 1:
            return F.conv2d(features, self.convolution.weight)
        if periodic:
            features = wrap(features)
            return F.conv2d(features, self.convolution.weight)
        return F.conv2d(features, self.convolution.weight, padding=1)


class Decoder(nn.Module):
    """Noise and code in, six raw outputs out; `maps_from_raw` gives them their meaning."""

    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        down, up = [], []
        channels = config.inputs
        for width in widths:
            down.append(_block(channels, width, config.convolutions[0]))
            channels = width
        for width in reversed(widths[:-1]):
            up.append(
                _block(channels + width + config.order_channels, width, config.convolutions[1])
            )
            channels = width
        with torch.no_grad():
            for block in up:
                first = next(iter(_layers_of(block)))
                first.convolution.weight[:, -config.order_channels :] *= _ORDER_GAIN
        self.down = nn.ModuleList(down)
        self.up = nn.ModuleList(up)
        self.head = ConvolutionLayer(channels, OUTPUTS, kernel=1, activate=False)

    def down_layers(self) -> list[list[ConvolutionLayer]]:
        """Layers of every block on the way down, full resolution first."""
        return [_layers_of(block) for block in self.down]

    def up_layers(self) -> list[list[ConvolutionLayer]]:
        """Layers of every block on the way up, coarsest first."""
        return [_layers_of(block) for block in self.up]

    def layers(self) -> list[ConvolutionLayer]:
        """All layers in the order they run."""
        blocks = [*self.down_layers(), *self.up_layers()]
        return [layer for block in blocks for layer in block] + [self.head]

    def forward(
        self,
        field: RandomField,
        code: Tensor,
        moments: Sequence[Moments] | None = None,
        *,
        periodic: bool = True,
    ) -> Tensor:
        """Raw outputs (B, OUTPUTS, H, W) of a random field, float32.

        Args:
            field: noise (B, config.inputs, H, W) and order, H and W multiples of ALIGNMENT.
            code: (CODE_SIZE,), of one material.
            moments: frozen statistics, one a layer; None measures them on this very field.
            periodic: wrap around the borders; otherwise the outermost texels are not valid.
        """
        remaining = None if moments is None else iter(moments)

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            return layer.adain(features, code, None if remaining is None else next(remaining))

        return self._run(field, adapt, periodic)

    def reference_moments(self, field: RandomField, code: Tensor) -> list[Moments]:
        """Every layer's statistics on a periodic reference field, in running order."""
        recorded: list[Moments] = []

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            adapted, moments = layer.adain.measured(features, code)
            recorded.append(moments)
            return adapted

        self._run(field, adapt, periodic=True)
        return recorded

    def way_down(
        self, noise: Tensor, step: Callable[[ConvolutionLayer], LayerStep]
    ) -> list[Tensor]:
        """What the way up reads at every level, full resolution first."""
        return descend(noise, [[step(layer) for layer in block] for block in self.down_layers()])

    def _run(
        self,
        field: RandomField,
        adapt: Callable[[ConvolutionLayer, Tensor], Tensor],
        periodic: bool,
    ) -> Tensor:
        def step(layer: ConvolutionLayer) -> LayerStep:
            def apply(features: Tensor) -> Tensor:
                adapted = adapt(layer, layer.convolve(features, periodic))
                return F.relu_(adapted) if layer.activate else adapted

            return apply

        up = [[step(layer) for layer in block] for block in self.up_layers()]
        skips = self.way_down(field.noise, step)
        return ascend(skips, field.waves, up, step(self.head), periodic=periodic).float()


def with_cells(decoder: Decoder, other: Decoder) -> Decoder:
    """A decoder that reads the noise of cells, too, by the weights of another one.

    Args:
        decoder: without cells.
        other: of the same shape, with cells.
    """
    wider, state = copy.deepcopy(other), decoder.state_dict()
    for name, weight in wider.state_dict().items():
        if weight.shape != state[name].shape:  # cells come last
            read = torch.cat([state[name], weight[:, state[name].shape[1] :]], dim=1)
            state[name] = read.contiguous(memory_format=torch.channels_last)
    wider.load_state_dict(state)
    return wider


LayerStep = Callable[[Tensor], Tensor]


def unet(
    field: RandomField,
    down: Sequence[Sequence[LayerStep]],
    up: Sequence[Sequence[LayerStep]],
    head: LayerStep,
    *,
    periodic: bool,
) -> Tensor:
    """The network's wiring, whatever its steps are made of (training layers or folded ones)."""
    return ascend(descend(field.noise, down), field.waves, up, head, periodic=periodic)


def descend(noise: Tensor, down: Sequence[Sequence[LayerStep]]) -> list[Tensor]:
    """The way down: features of every level, full resolution first."""
    features = noise.contiguous(memory_format=torch.channels_last)
    skips = []
    for level, block in enumerate(down):
        if level > 0:
            features = F.max_pool2d(features, 2)
        for step in block:
            features = step(features)
        skips.append(features)
    return skips


def ascend(
    skips: Sequence[Tensor],
    waves: Sequence[Tensor],
    up: Sequence[Sequence[LayerStep]],
    head: LayerStep,
    *,
    periodic: bool,
) -> Tensor:
    """The way up: from the coarsest features, joined at every level by its own and its waves."""
    features = skips[-1]
    for level, block in zip(reversed(range(DEPTH)), up, strict=True):
        parts = [upsample(features, periodic), skips[level]]
        if waves:
            parts.append(waves[level].to(features))
        features = torch.cat(parts, dim=1)
        for step in block:
            features = step(features)
    return head(features)


def upsample(features: Tensor, periodic: bool) -> Tensor:
    """Twice the size, bilinear; as a torus where periodic."""
    if not periodic:
        return F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
    padded = wrap(features)
    doubled = F.interpolate(padded, scale_factor=2, mode="bilinear", align_corners=False)
    return doubled[..., 2:-2, 2:-2]


def maps_from_raw(raw: Tensor, texel_size: float, *, periodic: bool = False) -> MapSet:
    """Maps of raw outputs (..., OUTPUTS, H, W): sigmoids, and a height counted in texels.

    A height in texels keeps slopes, and so what is learnt, apart from the picture's size.
    """
    diffuse, specular, roughness, height = raw.split([3, 1, 1, 1], dim=-3)
    return MapSet(
        diffuse=torch.sigmoid(diffuse),
        specular=torch.sigmoid(specular),
        roughness=torch.sigmoid(roughness),
        height=height * texel_size,
        texel_size=texel_size,
        periodic=periodic,
    )


def _draw(weight: Tensor, deviation: float) -> None:
    """Draw from a normal distribution, unless the weight takes no memory (the meta device).

    There it would change nothing but import PyTorch's compiler, two seconds' work.
    """
    if not weight.is_meta:
        nn.init.normal_(weight, std=deviation)


def _block(inputs: int, outputs: int, convolutions: int) -> nn.Sequential:
    sizes = [inputs] + [outputs] * convolutions
    return nn.Sequential(
        *(ConvolutionLayer(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True))
    )


def _layers_of(block: nn.Module) -> list[ConvolutionLayer]:
    return [layer for layer in block.children() if isinstance(layer, ConvolutionLayer)]
