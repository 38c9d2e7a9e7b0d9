"""Whether a capture keeps its time limit on this machine, and the detail that fits into it."""

from __future__ import annotations

import math
import time
from dataclasses import replace

from matcap.capture.settings import TIME_FOR_DETAIL, CaptureSettings
from matcap.errors import UsageError
from matcap.files.settings import spoken_duration

# Seconds of the shortest capture, from the command's start to its end, on one idle thread of a
# machine that does `slowness`'s work in _WORK seconds.
LEAST_TIME, _WORK = 12.0, 0.07
_VARIES = 1.25  # factor by which a busy machine may become slower during a capture
_EACH = 0.25  # share of that which each further photograph of a set adds


def slowness() -> float:
    """Wall time of a small piece of work, over that on the machine of LEAST_TIME.

    2 on a machine of half the speed, or on one whose processors do something else half of the time.
    """
    import numpy as np

    numbers = np.fft.irfft2(np.random.default_rng(0).standard_normal((512, 257)))

    def seconds() -> float:
        began = time.perf_counter()
        for _ in range(8):
            np.sort(np.fft.irfft2(np.fft.rfft2(numbers)), axis=0)
        return time.perf_counter() - began

    slower = max(seconds(), seconds()) / _WORK
    return slower * _VARIES if slower > _VARIES else slower


def within_time(settings: CaptureSettings, photographs: int, slower: float) -> CaptureSettings:
    """Settings of a capture that keeps its time limit: the detail that fits into it.

    `photographs` are those of the sample, `slower` is the `slowness` of this machine.

    Raises:
        UsageError: the limit is shorter than the shortest capture.
    """
    if settings.time_limit is None:
        return settings
    longer = slower * (1.0 + _EACH * (photographs - 1))
    if settings.time_limit < LEAST_TIME * longer:
        least = spoken_duration(math.ceil(LEAST_TIME * longer))
        raise UsageError.at(
            "--time",
            f"the shortest capture takes about {least} on this machine as busy as it is now",
            f"give {least} or more, or --preset instant",
        )
    if settings.detail is not None or settings.generator == "decoder":
        return settings
    limit = settings.time_limit / longer
    return replace(settings, detail=next(n for least, n in TIME_FOR_DETAIL if limit >= least))
