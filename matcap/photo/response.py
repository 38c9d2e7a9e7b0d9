"""How much darker one photograph of a scene is than another, and the tone curve that both share.

Of a pixel with light x in the first and k x in the second, with k < 1 and the curve g of photo.py,

    log u_w(g(x)) - log u_w(g(k x)) = -c log k,    u_w(y) = y (1 - w) / (1 - w y) = x^c,

whatever x is: the shoulder w is the one at which the left side is the same in all tones
([debevec1997], with one curve of two numbers in place of a table). The exponent c is then known if
k is, by exposure metadata; else it is the prior's and gives k. Of a curve g in one picture and
linear light in the other, c and w follow from the pair alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.photo.photo import (
    Development,
    ToneCurve,
)

Values = NDArray[np.float64]

_SHOULDERS = np.linspace(0.0, 0.9, 37)
_SHOULDER_DEVIATION = 0.3  # prior standard deviation of w
_BINS = 24  # by the first picture's value, of equal width in its logarithm
_FEWEST = 50  # pixels of a bin
_LEAST_BINS = 4
_BIN_DEVIATION = 0.02  # log; systematic error of a bin's mean
# Range of c; metadata that would need another is of no flash exposure and not used.
_EXPONENTS = (0.85, 1.5)


@dataclass(frozen=True)
class Ratio:
    """How a darker photograph relates to a brighter one of the same place."""

    darker: float
    """k, light of the darker one over that of the brighter, below 1."""
    curve: ToneCurve | None
    """Curve of those that are not linear; None if both are."""
    residual: float
    """Standard deviation of the log ratio of bins about the fit."""


@dataclass(frozen=True)
class Tones:
    """What is known of the tone curve of one of the two pictures."""

    linear: bool
    """Whether its values are proportional to light."""
    prior: Development
    """Prior of its curve, if it is not linear."""


def fit_ratio(
    brighter: Values, darker: Values, tones: tuple[Tones, Tones], stated: float | None
) -> Ratio | None:
    """Fit the ratio of exposures, and curves if there are any; None with too few tones in common.

    Args:
        brighter, darker: (n,) values of the same places, unclipped in both.
        tones: what is known of each.
        stated: k by metadata, or None.
    """
    bins = _binned(brighter, darker)
    if bins is None:
        return None
    y, z, weight = bins
    first, second = tones
    if first.linear and second.linear:
        steps = np.log(z) - np.log(y)
        log_k = float(np.average(steps, weights=weight))
        return Ratio(math.exp(log_k), None, _spread(steps - log_k, weight))
    if first.linear or second.linear:
        return _against_light(y, z, weight, tones)
    held = min(first.prior.shoulder, second.prior.shoulder) == 0.0
    best: tuple[float, float, float] | None = None
    for w in [0.0] if held else _SHOULDERS:
        steps = _power(z, w) - _power(y, w)
        mean = float(np.average(steps, weights=weight))
        spread = _spread(steps - mean, weight)
        cost = spread**2 + (_BIN_DEVIATION * (w - first.prior.shoulder) / _SHOULDER_DEVIATION) ** 2
        if best is None or cost < best[0]:
            best = cost, float(w), mean
    assert best is not None
    _, shoulder, mean = best
    spread = _spread(_power(z, shoulder) - _power(y, shoulder) - mean, weight)
    exponent = math.exp(first.prior.log_exponent)
    if stated is not None and 0.0 < stated < 1.0:
        implied = mean / math.log(stated)
        exponent = implied if _EXPONENTS[0] < implied < _EXPONENTS[1] else exponent
    curve = ToneCurve(exponent, shoulder)
    return Ratio(math.exp(mean / exponent), curve, spread / exponent)


def _against_light(
    y: Values, z: Values, weight: Values, tones: tuple[Tones, Tones]
) -> Ratio | None:
    """The ratio of a picture with a curve and one without, by regression for each shoulder."""
    curved_first = not tones[0].linear
    coded, light = (y, z) if curved_first else (z, y)
    prior = tones[0].prior if curved_first else tones[1].prior
    shoulders = [0.0] if prior.shoulder == 0.0 else _SHOULDERS
    best: tuple[float, float, float, float] | None = None
    terms = np.stack([np.log(light), np.ones_like(light)], axis=1) * np.sqrt(weight)[:, None]
    for w in shoulders:
        power = _power(coded, w)
        slope, offset = np.linalg.lstsq(terms, power * np.sqrt(weight), rcond=None)[0]
        spread = _spread(power - slope * np.log(light) - offset, weight)
        cost = spread**2 + (_BIN_DEVIATION * (w - prior.shoulder) / _SHOULDER_DEVIATION) ** 2
        if slope > 0.0 and (best is None or cost < best[0]):
            best = cost, float(w), float(slope), float(offset)
    if best is None or not 0.5 < best[2] < 2.5:
        return None
    cost, shoulder, exponent, offset = best
    # log u = c (log light + log of the coded picture's light over it).
    log_more = offset / exponent
    curve = ToneCurve(exponent, shoulder)
    log_k = -log_more if curved_first else log_more
    return Ratio(math.exp(log_k), curve, math.sqrt(cost) / exponent)


def _power(y: Values, shoulder: float) -> Values:
    """Log u_w(y) = c log x."""
    return np.asarray(np.log(y) + math.log1p(-shoulder) - np.log1p(-shoulder * y))


def _binned(brighter: Values, darker: Values) -> tuple[Values, Values, Values] | None:
    """Means of both by bins of the brighter's logarithm, and weights; None with too few."""
    if brighter.size < _FEWEST:
        return None
    log = np.log(brighter)
    low, high = np.quantile(log, [0.001, 0.9995])
    place = np.clip((log - low) / max(high - low, 1e-9) * _BINS, 0, _BINS - 1e-6).astype(int)
    count = np.bincount(place, minlength=_BINS).astype(np.float64)
    # Medians, as few places that moved would shift a mean.
    order = np.argsort(place, kind="stable")
    ends = np.cumsum(count).astype(int)
    parts = [order[end - int(n) : end] for end, n in zip(ends, count, strict=True)]
    kept = [part for part in parts if len(part) >= _FEWEST]
    if len(kept) < _LEAST_BINS:
        return None
    y = np.array([np.median(brighter[part]) for part in kept])
    z = np.array([np.median(darker[part]) for part in kept])
    scatter = np.array([np.std(np.log(darker[part])) / math.sqrt(len(part)) for part in kept])
    return y, z, 1.0 / (np.square(scatter) + _BIN_DEVIATION**2)


def _spread(rest: Values, weight: Values) -> float:
    return math.sqrt(float(np.average(np.square(rest), weights=weight)))
