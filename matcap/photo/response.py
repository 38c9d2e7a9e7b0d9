"""How much darker one photograph of a scene is than another, and the tone curve that both share.

Of a pixel with light x in the first and k x in the second, with k < 1 and the curve g of photo.py,

    log u_w(g(x)) - log u_w(g(k x)) = -c log k,    u_w(y) = y (1 - w) / (1 - w y) = x^c,

whatever x is, and g(x) and g(k x) have the same rank among the values of their channel. The
shoulder w is the one at which the left side is the same in all tones ([debevec1997], with two
numbers in place of a table). The exponent c is then known if k is, by exposure metadata; else
it is the prior's and gives k. Of a curve g in one picture and linear light in the other, the pair
alone gives c, and with the stated k also w and k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.photo.photo import Development, Photo, ToneCurve

Values = NDArray[np.float64]
Picture = NDArray[np.float32]

_SHOULDERS = np.linspace(0.0, 0.9, 37)
_SHOULDER_DEVIATION = 0.3  # prior standard deviation of w
_DARKEST_CODES = 6.0  # steps of 8-bit codes, below which developed values are not compared
_BRIGHTEST = 0.9  # of the clip level, above which values are not compared
_TONES = 32  # values compared, of equal steps in the logarithm of the brighter picture's
_FEWEST = 50  # pixels of a picture, and twice those left out at either end
_AROUND = 10  # ranks to either side that are averaged
_LEAST_TONES = 5
_TONE_DEVIATION = 0.02  # log; systematic error of a tone
# Prior standard deviation of log k about the stated ratio of a developed picture and a RAW, whose
# white is a third of a stop or so above the picture's.
_STATED_DEVIATION = 0.2
_ROUNDS = 6  # of Gauss and Newton
# Range of c; metadata that would need another is of no flash exposure and not used.
_EXPONENTS = (0.85, 1.5)


@dataclass(frozen=True)
class ExposureRatio:
    """How a darker photograph relates to a brighter one of the same place."""

    darker: float
    """k, light of the darker one over that of the brighter, below 1."""
    curve: ToneCurve | None
    """Curve of those that are not linear; None if both are."""
    residual: float
    """Root-mean-square of the log ratio of tones about the fit."""


Tones = tuple[Development | None, Development | None]
"""Prior of the curve of each picture; None where values are proportional to light."""
Limits = tuple[float, float, float]
"""Values that are compared: the least and the largest of the brighter picture, and the least of the
darker one, whose codes are coarse."""


def faintest_value(photo: Photo) -> float:
    """Value of a photograph below which it is not compared with others."""
    if photo.radiometric or photo.floating:
        return 1e-3
    code = np.array(_DARKEST_CODES / (255.0 * 12.92))
    return float((photo.tone or ToneCurve()).linear(code))


def ratio_of_exposures(
    brighter: Photo, darker: Photo, pixels: tuple[Picture, Picture], curve: ToneCurve | None
) -> ExposureRatio | None:
    """The ratio of two photographs' exposures; None with too few tones in common.

    Args:
        brighter, darker: the photographs.
        pixels: (n, channels) their values at the same places.
        curve: that of all that are not linear, if known.
    """
    pair = brighter, darker
    known = [(curve if photo.tone_mapped else None) or ToneCurve() for photo in pair]
    y, z = (by.linear(np.asarray(each, np.float64)) for by, each in zip(known, pixels, strict=True))
    first, second = (
        photo.development if curve is None and photo.tone_mapped else None for photo in pair
    )
    stated = None
    if brighter.exposure is not None and darker.exposure is not None:
        stated = darker.exposure / brighter.exposure
    limits = (
        float(known[0].linear(np.array(faintest_value(brighter)))),
        float(known[0].linear(np.array(_BRIGHTEST * min(brighter.headroom, 1e30)))),
        float(known[1].linear(np.array(faintest_value(darker)))),
    )
    return fit_ratio(y, z, (first, second), stated, limits)


def fit_ratio(
    brighter: Values,
    darker: Values,
    tones: Tones,
    stated: float | None,
    limits: Limits = (0.0, math.inf, 0.0),
) -> ExposureRatio | None:
    """Fit the ratio of exposures, and curves if there are any; None with too few tones in common.

    Args:
        brighter, darker: (n, channels) values of the same places, clipped ones too, as their ranks
            count.
        tones: prior of each one's curve.
        stated: k by metadata, or None.
        limits: of the values that are compared.
    """
    channels = zip(brighter.T, darker.T, strict=True)
    pairs = [pair for each in channels if (pair := _matched(*each, limits)) is not None]
    if not pairs:
        return None
    y, z = (np.concatenate(values) for values in zip(*pairs, strict=True))
    first, second = tones
    if first is None and second is None:
        steps = np.log(z) - np.log(y)
        log_k = float(np.median(steps))  # the brightest tones are means that clipping lowers
        return ExposureRatio(math.exp(log_k), None, _spread(steps - log_k))
    if first is None or second is None:
        return _against_light(y, z, tones, stated)

    def fitted(w: float) -> tuple[float, float]:
        """Mean and root-mean-square deviation of log k to the power c."""
        steps = _power(z, w) - _power(y, w)
        mean = float(steps.mean())
        return mean, _spread(steps - mean)

    def cost(w: float) -> float:
        return fitted(w)[1] ** 2 + _off_prior(w - first.shoulder, _SHOULDER_DEVIATION)

    straight = min(first.shoulder, second.shoulder) == 0.0
    shoulder = 0.0 if straight else float(min(_SHOULDERS, key=cost))
    mean, spread = fitted(shoulder)
    exponent = math.exp(first.log_exponent)
    if stated is not None and 0.0 < stated < 1.0:
        implied = mean / math.log(stated)
        exponent = implied if _EXPONENTS[0] < implied < _EXPONENTS[1] else exponent
    curve = ToneCurve(exponent, shoulder)
    return ExposureRatio(math.exp(mean / exponent), curve, spread / exponent)


def _against_light(
    y: Values, z: Values, tones: Tones, stated: float | None
) -> ExposureRatio | None:
    """The ratio of a picture with a curve and one without, by regression for each shoulder.

    Of a darker picture with a curve the tones leave w and k open together: the stated k decides.
    """
    coded, light, sign = (y, np.log(z), -1.0) if tones[0] else (z, np.log(y), 1.0)
    # sign is of log k in the log of the coded picture's light.
    known = None if stated is None or not 0.0 < stated < 1.0 else sign * math.log(stated)
    usual = (tones[0] or tones[1] or Development()).shoulder
    fits = []
    for w in [0.0] if usual == 0.0 else _SHOULDERS:
        power = _power(coded, w)
        slope, more = _line(light, power, known)
        spread = _spread(power - slope * (light + more))
        cost = spread**2 + _off_prior(w - usual, _SHOULDER_DEVIATION)
        cost += 0.0 if known is None else _off_prior(more - known, _STATED_DEVIATION)
        if slope > 0.0:
            fits.append((cost, float(w), slope, more, spread))
    _, shoulder, exponent, more, spread = min(fits, default=(0.0,) * 5)
    if not 0.5 < exponent < 2.5:
        return None
    return ExposureRatio(math.exp(sign * more), ToneCurve(exponent, shoulder), spread / exponent)


def _off_prior(difference: float, deviation: float) -> float:
    """Cost of a number's difference from its prior mean, in squared deviations of a tone."""
    return float((_TONE_DEVIATION * difference / deviation) ** 2)


def _line(x: Values, y: Values, known: float | None) -> tuple[float, float]:
    """(c, b) of y = c (x + b) by least squares, b having the prior of a stated ratio of exposures.

    Gauss and Newton: the prior is of b, not of the intercept.
    """
    terms = np.stack([x, np.ones_like(x)], axis=1)
    c, intercept = np.linalg.lstsq(terms, y, rcond=None)[0]
    b = intercept / c if c > 0.0 else 0.0
    weight = math.sqrt(len(x)) * _TONE_DEVIATION / _STATED_DEVIATION
    for _ in range(_ROUNDS if known is not None and c > 0.0 else 0):
        terms = np.vstack([np.stack([x + b, np.full_like(x, c)], axis=1), [0.0, weight]])
        off = np.append(y - c * (x + b), weight * ((known or 0.0) - b))
        step = np.linalg.lstsq(terms, off, rcond=None)[0]
        c, b = c + step[0], b + step[1]
    return float(c), float(b)


def _power(y: Values, shoulder: float) -> Values:
    """Log u_w(y) = c log x."""
    return np.asarray(np.log(y) + math.log1p(-shoulder) - np.log1p(-shoulder * y))


def _matched(brighter: Values, darker: Values, limits: Limits) -> tuple[Values, Values] | None:
    """Values of the brighter picture, evenly spaced in their logarithm, and those of equal rank in
    the darker one; None with too few.

    Ranks need no registration, which sparkles and the flank of a highlight that moved would bias.
    """
    if brighter.size < _FEWEST:
        return None
    y, z = np.sort(brighter), np.sort(darker)
    low, high = max(limits[0], y[_FEWEST // 2]), min(limits[1], y[-_FEWEST // 2])
    if not 0.0 < low < high:
        return None
    targets = np.geomspace(low, high, _TONES)
    rank = np.searchsorted(y, targets).clip(_FEWEST // 2, y.size - _FEWEST // 2)
    equal = np.array([z[r - _AROUND : r + _AROUND + 1].mean() for r in rank])
    kept = equal > limits[2]
    if kept.sum() < _LEAST_TONES:
        return None
    return targets[kept], equal[kept]


def _spread(rest: Values) -> float:
    """Root-mean-square."""
    return math.sqrt(float(np.square(rest).mean()))
