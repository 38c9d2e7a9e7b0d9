"""Small exemplars: blobs without order, and a bond of bricks that a photograph has bent."""

import json
from dataclasses import replace
from functools import cache

import cv2
import numpy as np

from matcap.example.example import Example
from matcap.example.exemplar import Exemplar

PERIODS = (23.3, 17.1)  # texels along x and y of the bricks


def blobs(width=176, height=144, seed=1):
    """Spots of some six texels."""
    noise = np.random.default_rng(seed).standard_normal((4, height, width))
    y, x = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((np.hypot(x, y) * 20.0) ** 2))).real
    smooth /= smooth.std(axis=(1, 2), keepdims=True)
    return exemplar(smooth)


def bricks(width=240, height=200, periods=PERIODS, bend=0.1):
    """Every brick of its own colour; rows bend by a share of their height."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    y = y + bend * periods[1] * np.sin(x / 90.0)
    column, row = x / periods[0], y / periods[1]
    colour = np.sin(12.9898 * np.floor(column) + 78.233 * np.floor(row)) * 43758.5453 % 1.0
    joint = np.minimum(
        *(
            np.abs(at - np.rint(at)) * period
            for at, period in zip((column, row), periods, strict=True)
        )
    )
    raised = np.clip(joint / 2.0, 0.0, 1.0)
    grain = np.random.default_rng(2).standard_normal(x.shape) * 0.05
    return exemplar(np.stack([colour * raised + grain, raised, raised, raised]))


def grained(width=768, height=576, seed=5):
    """Albedo in streaks along x, some thirty times as long as wide."""
    noise = np.random.default_rng(seed).standard_normal((height, width)).astype(np.float32)
    streaks = cv2.GaussianBlur(noise, (0, 0), sigmaX=120.0, sigmaY=4.0)
    streaks /= streaks.std()
    return exemplar(np.stack([streaks, streaks, streaks, 0.0 * streaks]))


def exemplar(planes):
    """An exemplar whose maps follow four planes."""
    shares = [0.5 + 0.15 * np.tanh(plane)[None] for plane in planes]
    floats = [np.ascontiguousarray(share, np.float32) for share in shares]
    return Exemplar(
        diffuse=np.concatenate([floats[0], floats[1], floats[0]]),
        specular=0.1 * floats[1],
        roughness=floats[2],
        height=0.01 * floats[3],
        confidence=np.ones((4, *planes.shape[1:]), np.float32),
        texel_size=2 / 1024,
    )


def coloured(piece):
    """The same with an F0 as bright as it was and as red as its albedo is."""
    red = piece.diffuse[:1]
    hue = np.concatenate([red, np.full_like(red, 0.5), 1.0 - red])
    luminance = np.float32(0.2126) * red + np.float32(0.3576) + np.float32(0.0722) * (1.0 - red)
    return replace(piece, specular=(piece.specular * hue / luminance).astype(np.float32))


def reread(stored):
    """An Exemplar or Example written to a file and read again."""
    tensors, about = stored.stored()
    return type(stored).read(json.loads(json.dumps(about)), tensors.__getitem__)


@cache
def an_example():
    return Example.of(blobs())


@cache
def a_coloured_example():
    return Example.of(coloured(blobs()))


@cache
def ordered(width=240, height=200, periods=PERIODS, bend=0.1):
    waves = ((1 / periods[0], 0.0), (0.0, 1 / periods[1]))
    return Example.of(bricks(width, height, periods, bend), waves)


@cache
def large_blobs():
    return Example.of(blobs(512, 384))


@cache
def varied(made, variety):
    """The example that `made` makes, of another variety."""
    return made().varied(variety)
