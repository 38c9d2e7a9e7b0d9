"""Whether a field repeats: its autocorrelation beside the correlation of independent seeds.

Texels farther apart than twice the network's reach share no noise. What correlation is left there
is the noise of a finite map, which maps of two seeds have as well.
"""

import numpy as np

from matcap.field.field import Field
from matcap.field.plane import Span
from matcap.space.freeze import spans_of
from matcap.space.tuned import TunedDecoder


def reach(material):
    """Texels that a texel's value depends on, to each side."""
    convolutions = material.part(TunedDecoder).decoder.config.convolutions
    return -spans_of(Span(0, 512), convolutions).down[0].start


def correlations(material, size, seeds=(1, 2, 3), period=None):
    """Largest correlation of a map with itself beyond the reach, and of maps of two seeds."""
    fields = (Field(material, seed, period) for seed in seeds)
    maps = [field.read(0, 0, size, size).roughness[0].numpy() for field in fields]
    spectra = [np.fft.rfft2((m - m.mean()) / m.std()) for m in maps]
    lag = np.minimum(np.arange(size), size - np.arange(size))
    far = np.maximum(lag[:, None], lag[None, :]) > 2 * reach(material)

    def largest(a, b):
        return float(np.abs(np.fft.irfft2(a * b.conj(), s=(size, size)) / size**2)[far].max())

    own = [largest(a, a) for a in spectra]
    others = [largest(spectra[i], spectra[i - 1]) for i in range(len(seeds))]
    return own, others
