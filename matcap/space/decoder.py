"""The decoder: a U-Net that turns a random field into maps [henzler2021, sec. 4.2]."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import Function, FunctionCtx, once_differentiable

from matcap.brdf.maps import MapSet
from matcap.space.random_field import WAVE_CHANNELS, RandomField


def wrap(features: Tensor) -> Tensor:
    """(B, C, H + 2, W + 2) of (B, C, H, W), padded circularly by one texel.

    Equal to torch.nn.functional.pad(mode="circular"), whose gradient copies the whole tensor once
    for every side; this one does not.
    """
    # torch leaves apply untyped.
    return _Wrap.apply(features)  # type: ignore[no-untyped-call]


class _Wrap(Function):
    @staticmethod
    def forward(ctx: FunctionCtx, features: Tensor) -> Tensor:
        return F.pad(features, (1, 1, 1, 1), mode="circular")

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, gradient: Tensor) -> Tensor:
        """Add the gradient of each border texel to that of the texel it is a copy of."""
        rows = gradient[..., 1:-1, :].clone()
        rows[..., 0, :] += gradient[..., -1, :]
        rows[..., -1, :] += gradient[..., 0, :]
        texels = rows[..., 1:-1]
        texels[..., 0] += rows[..., -1]
        texels[..., -1] += rows[..., 0]
        return texels


def convolve(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, *, activate: bool
) -> Tensor:
    """ReLU(bias + sum over i of parts[i] * weights[i]), * a convolution without padding.

    The frozen network's only costly operation. A convolution of concatenated features is the sum of
    the convolutions of its parts, so that nothing is concatenated. Where oneDNN supports it, bias,
    sum and ReLU are fused into the convolution.

    Args:
        parts: (B, C_i, H, W), in channels_last memory format.
        weights: (out, C_i, k, k), likewise.
        bias: (out,).

    Returns:
        (B, out, H - k + 1, W - k + 1), likewise.
    """
    if _fused(parts[0]):
        return _convolve_fused(parts, weights, bias, activate)
    total = F.conv2d(parts[0], weights[0], bias)
    for part, weight in zip(parts[1:], weights[1:], strict=True):
        total += F.conv2d(part, weight)
    return total.relu_() if activate else total


def _fused(features: Tensor) -> bool:
    if features.device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return False
    if features.dtype == torch.bfloat16:
        return torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return features.dtype == torch.float32


def _convolve_fused(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, activate: bool
) -> Tensor:
    shape = ([0, 0], [1, 1], [1, 1], 1)  # padding, stride, dilation, groups
    ends = [*["none"] * (len(parts) - 1), "relu" if activate else "none"]
    total = torch.ops.mkldnn._convolution_pointwise(
        parts[0], weights[0], bias, *shape, ends[0], [], ""
    )
    for part, weight, end in zip(parts[1:], weights[1:], ends[1:], strict=True):
        unary = end if end == "relu" else None
        total = torch.ops.mkldnn._convolution_pointwise_(
            total, part, weight, None, *shape, "add", 1.0, unary, [], None
        )
    return total


# Noise enters at full resolution, is halved by max-pooling four times and doubled back by bilinear
# upsampling with skip connections. On the way up every level also receives a drawing, if the
# decoder reads one (freeze.py), and the material's lattice channels, if it has a lattice
# (random_field.py). They are not inputs of the way down, where max-pooling would alias them.
#
# Every convolution is followed by AdaIN [huang2017], whose target mean and deviation are affine in
# the 64-D latent vector; also the last one, so that each map's mean and contrast are affine in it.
# AdaIN normalises by statistics of its input (training), by stored ones (frozen; see freeze.py), or
# by running ones (tuning/finetune.py).
#
# A rectangle is decoded either as a torus (`periodic=True`) or with a halo of noise around it,
# which the caller cuts off; no border is padded.

CODE_SIZE = 64  # dimensions of the latent vector, as in the paper
OUTPUTS = 6  # diffuse (3), specular, roughness, height
DEPTH = 4  # poolings; rectangles are multiples of 2^DEPTH
ALIGNMENT = 2**DEPTH  # texels: sides and periods are multiples of this
DRAWING_CHANNELS = 2  # of a decoder that reads a drawing
_LATTICE_GAIN = 3.0  # factor on initial weights of lattice channels, which are few among features
EPSILON = 1e-5  # added to variances


@dataclass(frozen=True)
class DecoderConfig:
    """Channels and layers of a decoder."""

    noise_channels: int = 8
    """Channels of white noise at full resolution."""
    widths: tuple[int, ...] = (16, 32, 64, 64, 64)
    """Feature channels per level, full resolution first; DEPTH + 1 of them."""
    convolutions: tuple[int, int] = (1, 2)
    """3 x 3 convolutions per block on the way down and on the way up."""
    cells: int = 0
    """Channels of noise that is constant over each lattice cell (random_field.py)."""
    drawing: int = 0
    """Channels of the drawing (freeze.py): DRAWING_CHANNELS, or 0 as in the paper."""

    @property
    def lattice_channels(self) -> int:
        """Lattice channels of every level of the way up."""
        return WAVE_CHANNELS + self.cells


Moments = tuple[Tensor, Tensor]  # mean and standard deviation, (channels,) each


class AdaIN(nn.Module):
    """Adaptive instance normalisation [huang2017]; targets are affine in the latent vector."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.affine = nn.Linear(CODE_SIZE, 2 * channels)
        _draw(self.affine.weight, 0.05)
        nn.init.zeros_(self.affine.bias)
        self.affine.bias.data[channels:] = 1.0

    def target(self, code: Tensor) -> Moments:
        """Target mean and deviation for a latent vector (CODE_SIZE,)."""
        mean, deviation = self.affine(code).chunk(2, dim=-1)
        return mean, deviation

    def affine_of(self, code: Tensor, moments: Moments) -> Moments:
        """(scale, shift), (channels,) each: normalisation by `moments`, then the targets."""
        mean, deviation = moments
        wanted_mean, wanted_deviation = self.target(code)
        scale = wanted_deviation / deviation
        return scale, wanted_mean - mean * scale

    def forward(self, features: Tensor, code: Tensor, moments: Moments | None) -> Tensor:
        """Normalise features (B, C, H, W) and scale them to the targets.

        Statistics are `moments`, or else those of the features over the whole batch, which is of
        one material. Fused batch normalisation is eight times as fast as separate operations.
        """
        exact = torch.promote_types(features.dtype, torch.float32)
        mean, deviation = (target.to(exact) for target in self.target(code))
        own = variance = None
        if moments is not None:
            own, variance = moments[0], moments[1].square() - EPSILON
        return F.batch_norm(features, own, variance, deviation, mean, moments is None, 0.0, EPSILON)

    def measured(self, features: Tensor, code: Tensor) -> tuple[Tensor, Moments]:
        """Normalise by the features' own moments (C,), which are returned as well; in float32."""
        mean, deviation = (target.float() for target in self.target(code))
        adapted, own, inverse = torch.native_batch_norm(
            features.float(), deviation, mean, None, None, True, 0.0, EPSILON
        )
        return adapted, (own, inverse.reciprocal())


class ConvolutionLayer(nn.Module):
    """Convolution, AdaIN, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, activate: bool = True) -> None:
        super().__init__()
        # No bias: AdaIN subtracts the mean.
        self.convolution = nn.Conv2d(inputs, outputs, kernel, bias=False)
        _draw(self.convolution.weight, math.sqrt(2.0 / (inputs * kernel * kernel)))
        # The memory format in which convolutions on the processor are fastest.
        weight = self.convolution.weight.data.contiguous(memory_format=torch.channels_last)
        self.convolution.weight.data = weight
        self.adain = AdaIN(outputs)
        self.activate = activate

    def convolve(self, features: Tensor, periodic: bool) -> Tensor:
        """The convolution alone, of the input's size; zero padding where not periodic."""
        border = self.convolution.weight.shape[-1] // 2  # of 1 x 1 and 3 x 3 kernels
        if periodic and border:
            features, border = wrap(features), 0
        # Lattice channels come last, and are left out where there is no lattice.
        return F.conv2d(features, self.convolution.weight[:, : features.shape[1]], padding=border)


class Decoder(nn.Module):
    """Random field and latent vector to six raw outputs, which maps_from_raw turns into maps."""

    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        down, up = [], []
        channels = config.noise_channels
        for width in widths:
            down.append(_block(channels, width, config.convolutions[0]))
            channels = width
        for width in reversed(widths[:-1]):
            read = channels + width + config.drawing + config.lattice_channels
            up.append(_block(read, width, config.convolutions[1]))
            channels = width
        with torch.no_grad():
            for block in up:
                first = next(iter(_layers_of(block)))
                first.convolution.weight[:, -config.lattice_channels :] *= _LATTICE_GAIN
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
        """All layers in order of execution."""
        blocks = [*self.down_layers(), *self.up_layers()]
        return [layer for block in blocks for layer in block] + [self.head]

    def drawing_weights(self) -> list[Tensor]:
        """Views of the weights that read the drawing, coarsest level first; none without one."""
        end = -self.config.lattice_channels
        read = slice(end - self.config.drawing, end)
        firsts = [block[0].convolution.weight.detach() for block in self.up_layers()]
        return [weight[:, read] for weight in firsts] if self.config.drawing else []

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
            field: noise (B, config.noise_channels, H, W) and lattice, H and W multiples of
                ALIGNMENT.
            code: (CODE_SIZE,) latent vector.
            moments: frozen statistics, one a layer; None computes them from the features.
            periodic: decode as a torus; otherwise a halo at the borders is not valid.
        """
        remaining = None if moments is None else iter(moments)

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            return layer.adain(features, code, None if remaining is None else next(remaining))

        return self.run(field, adapt, periodic=periodic)

    def reference_moments(self, field: RandomField, code: Tensor) -> list[Moments]:
        """Every layer's statistics on a periodic reference field, in order of execution."""
        recorded: list[Moments] = []

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            adapted, moments = layer.adain.measured(features, code)
            recorded.append(moments)
            return adapted

        self.run(field, adapt)
        return recorded

    def run(
        self,
        field: RandomField,
        adapt: Callable[[ConvolutionLayer, Tensor], Tensor],
        *,
        periodic: bool = True,
    ) -> Tensor:
        """Raw outputs, as forward(), with every convolution's output normalised by `adapt`."""

        def step(layer: ConvolutionLayer) -> LayerStep:
            def apply(features: Tensor) -> Tensor:
                adapted = adapt(layer, layer.convolve(features, periodic))
                return F.relu_(adapted) if layer.activate else adapted

            return apply

        down, up = (
            [[step(layer) for layer in block] for block in blocks]
            for blocks in (self.down_layers(), self.up_layers())
        )
        skips = descend(field.noise, down)
        return ascend(skips, field.read_up, up, step(self.head), periodic=periodic).float()


def with_cells(decoder: Decoder, other: Decoder) -> Decoder:
    """Add cell channels to a decoder, with the weights of another one.

    Args:
        decoder: without cell channels.
        other: of the same configuration but with cell channels.
    """
    wider, state = copy.deepcopy(other), decoder.state_dict()
    for name, weight in wider.state_dict().items():
        if weight.shape != state[name].shape:  # cells come last
            read = torch.cat([state[name], weight[:, state[name].shape[1] :]], dim=1)
            state[name] = read.contiguous(memory_format=torch.channels_last)
    wider.load_state_dict(state)
    return wider


def with_drawing(decoder: Decoder) -> Decoder:
    """Add a drawing's channels to a decoder, with weights of zero; itself if it has them."""
    if decoder.config.drawing:
        return decoder
    wider = copy.deepcopy(decoder)
    wider.config = replace(decoder.config, drawing=DRAWING_CHANNELS)
    for first, *_ in wider.up_layers():
        features, lattice = first.convolution.weight.detach().tensor_split(
            [-decoder.config.lattice_channels], dim=1
        )
        silent = torch.zeros_like(features[:, :DRAWING_CHANNELS])
        weight = torch.cat([features, silent, lattice], dim=1)
        first.convolution.weight = nn.Parameter(
            weight.contiguous(memory_format=torch.channels_last)
        )
    return wider


LayerStep = Callable[[Tensor], Tensor]


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
    read: Sequence[Tensor],
    up: Sequence[Sequence[LayerStep]],
    head: LayerStep,
    *,
    periodic: bool,
) -> Tensor:
    """The way up, from the coarsest features to the raw outputs.

    Args:
        skips: features of the way down, full resolution first.
        read: what each level reads besides features, or empty.
        up: layers by block, coarsest first.
    """
    features = skips[-1]
    for level, block in zip(reversed(range(DEPTH)), up, strict=True):
        parts = [upsample(features, periodic), skips[level]]
        if read:
            parts.append(read[level].to(features))
        features = torch.cat(parts, dim=1)
        for step in block:
            features = step(features)
    return head(features)


def upsample(features: Tensor, periodic: bool) -> Tensor:
    """(B, C, 2 H, 2 W) of (B, C, H, W), bilinear; as a torus where periodic."""
    padded = wrap(features) if periodic else features
    doubled = F.interpolate(padded, scale_factor=2, mode="bilinear", align_corners=False)
    return doubled[..., 2:-2, 2:-2] if periodic else doubled


def maps_from_raw(raw: Tensor, texel_size: float, *, periodic: bool = False) -> MapSet:
    """Maps of raw outputs (..., OUTPUTS, H, W): sigmoid of each, but height in texels.

    With height in texels, slopes do not depend on the texel size.
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
    """Initialise from a normal distribution, except on the meta device.

    There it has no effect but takes two seconds, for the import of PyTorch's compiler.
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
