"""Plot of a capture's error over time, with a forecast for another minute: error.png."""

from __future__ import annotations

import math

from PIL import Image, ImageDraw, ImageFont

from matcap.space.tuning.anytime import History, forecast

_SIZE = (720, 400)  # pixels, as are the margins
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 24, 60, 48
_INK, _PAPER, _GRID, _LINE, _AHEAD = "#e1e1e1", "#181818", "#3a3a3a", "#6cb6ff", "#f0b060"
_MINUTE = 60.0  # seconds


def draw_history(history: History, self_difference: float = math.nan) -> Image.Image:
    """Draw the error over seconds.

    Args:
        self_difference: of the photograph, drawn as a line unless NaN.
    """
    picture = Image.new("RGB", _SIZE, _PAPER)
    draw = ImageDraw.Draw(picture)
    font, small = ImageFont.load_default(size=16), ImageFont.load_default(size=13)
    if not history:
        draw.text((_LEFT, _TOP), "no step of fine-tuning was made", fill=_INK, font=font)
        return picture
    longest = max(history[-1][0], 1e-6)
    own = self_difference if math.isfinite(self_difference) else 0.0
    finite = [error for _, _, error in history if math.isfinite(error)] or [1.0]
    # The first errors may be far larger than all others.
    highest = 1.1 * max(sorted(finite)[int(0.98 * (len(finite) - 1))], own, 1e-9)

    def place(seconds: float, error: float) -> tuple[float, float]:
        width, height = _SIZE[0] - _LEFT - _RIGHT, _SIZE[1] - _TOP - _BOTTOM
        up = min(max(error / highest, 0.0), 1.0) if math.isfinite(error) else 1.0
        return _LEFT + seconds / longest * width, _SIZE[1] - _BOTTOM - up * height

    for tick in _ticks(highest):
        (x0, y), (x1, _) = place(0.0, tick), place(longest, tick)
        draw.line([(x0, y), (x1, y)], fill=_GRID)
        draw.text((x0 - 8, y), f"{tick:g}", fill=_INK, font=small, anchor="rm")
    for tick in _ticks(longest):
        x, y = place(tick, 0.0)
        draw.text((x, y + 8), f"{tick:g} s", fill=_INK, font=small, anchor="mt")
    if own:
        draw.line([place(0.0, own), place(longest, own)], fill=_AHEAD)
        x, y = place(longest, own)
        label = "difference between adjacent windows of the photograph"
        draw.text((x, y + 5), label, fill=_AHEAD, font=small, anchor="rt")
    draw.line([place(seconds, error) for seconds, _, error in history], fill=_LINE, width=2)
    for row, line in enumerate(_title(history, own)):
        draw.text((_LEFT, 10 + 20 * row), line, fill=_INK, font=font if row == 0 else small)
    return picture


def _title(history: History, own: float) -> list[str]:
    seconds, steps, error = history[-1]
    lines = [f"error {error:.3g} after {seconds:.0f} s and {steps} steps"]
    if own:
        lines[0] += f", {error / own:.2f} times the photograph's self-difference"
    ahead = forecast(history, _MINUTE)
    if ahead is not None:
        lines.append(f"another minute would bring it to about {ahead:.3g}")
    return lines


def _ticks(longest: float) -> list[float]:
    """Round numbers from 0 to `longest`, about five."""
    step = 10.0 ** math.floor(math.log10(longest / 4.0))
    step *= next(m for m in (1.0, 2.0, 5.0, 10.0) if longest / (m * step) <= 6.0)
    return [index * step for index in range(int(longest / step) + 1)]
