"""What a user can set of a capture, declared once: kinds, limits, words and help.

The command line's options, a shoot's matcap.toml and CaptureSettings itself are held to these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from matcap.errors import UsageError

# Statistics by name (target.py makes each), and whether a file of weights goes with them.
STATISTICS: Mapping[str, bool] = MappingProxyType({"filterbank": False, "vgg19": True})
STATISTICS_WORDS = "|".join(f"{name}=FILE" if file else name for name, file in STATISTICS.items())
PRESET_NAMES = ("instant", "draft", "standard", "high", "reference")


@dataclass(frozen=True)
class Choice:
    """A setting.

    Attributes:
        kinds: types of its values.
        help: one sentence or two for the command line.
        least, most: limits of a number.
        words: what a text may be; empty for any.
        metavar: what stands for its value in help, or None.
    """

    kinds: tuple[type, ...]
    help: str
    least: float = 0.0
    most: float = math.inf
    words: tuple[str, ...] = ()
    metavar: str | None = None

    def fits(self, value: float) -> bool:
        """Whether a number is within the limits; NaN is in none."""
        return math.isfinite(value) and self.least <= value <= self.most


CHOICES: Mapping[str, Choice] = MappingProxyType(
    {
        "preset": Choice(
            (str,), "How much work: instant (a first look, on half the texels), draft (whether the "
            "shot will do), standard (what one photograph gives), high (held to it three times as "
            "long) or reference (on all texels of 12 megapixels).",
            words=PRESET_NAMES,
        ),
        "steps": Choice(
            (int,), "Steps instead of the preset's: of adapting the piece, or of fine-tuning a "
            "decoder.", 0, 10_000_000,
        ),
        "time_limit": Choice(
            (int, float), "Have the whole of a capture end by then: 90s, 2m; without --steps the "
            "preset is reference then.", 0.001, 1e7, metavar="TIME",
        ),
        "target": Choice(
            (int, float), "With --generator decoder: stop at this error, in multiples of what the "
            "photograph's own windows differ by; without --steps the preset is reference then.",
            0.01, 1e6, metavar="TIMES",
        ),
        "detail": Choice(
            (int,), "Texels along the photograph's long side. By default 1024.", 64, 8192,
        ),
        "fov": Choice(
            (int, float), "Field of view along the long side, degrees.", 1.0, 170.0,
        ),
        "width_cm": Choice(
            (int, float), "What the photograph's long side spans, in centimetres: exports are true "
            "to scale.", 0.01, 1e5,
        ),
        "seed": Choice((int,), "Seed of the work and of the map set.", 0, 2**63 - 1),
        "prior": Choice(
            (str,), "With --generator decoder: trained prior to start from.",
            metavar="auto|none|PATH",
        ),
        "statistics": Choice(
            (str,), "What textures are compared by.", metavar=STATISTICS_WORDS,
        ),
        "generator": Choice(
            (str,), "What the material is made by: the photographed piece, rearranged (example), "
            "or the paper's network, fine-tuned (decoder).", words=("decoder", "example"),
        ),
        "crop": Choice(
            (str,), "What of the photograph is the material, in its own pixels as it is looked at; "
            "the rest is left out.", metavar="x,y,w,h",
        ),
        "mask": Choice(
            (str,), "A picture of the photograph's size: white is the material, black (a finger, a "
            "label, the table's edge) is left out.", metavar="FILE.png",
        ),
        "union": Choice(
            (bool,), "Of several photographs of one piece: the piece is all that they show, not "
            "the first one's rectangle alone.",
        ),
        "aligned": Choice(
            (bool,), "Also the maps of the photographed piece itself, NAME_photo, with confidence.",
        ),
    }
)  # fmt: skip


def check(name: str, value: Any) -> None:  # noqa: ANN401
    """Hold a number to the limits of its setting; None is no choice.

    Raises:
        UsageError: it is outside, or not finite.
    """
    choice = CHOICES[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or choice.fits(value):
        return
    raise UsageError(
        f"{value:g} is out of range" if isinstance(value, float) else f"{value} is out of range",
        where=f"--{'time' if name == 'time_limit' else name.replace('_', '-')}",
        remedy=f"give between {choice.least:g} and {choice.most:g}",
    )
