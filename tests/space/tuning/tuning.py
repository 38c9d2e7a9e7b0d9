"""A photograph and a decoder so small that a hundred steps take a second."""

import torch

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import render_rectified
from matcap.flash.rectify import plane_of
from matcap.space.decoder import CODE_SIZE, DecoderConfig, maps_from_raw
from matcap.space.tuning.finetune import TuneSettings, finetune
from matcap.space.tuning.match import PhotographTarget, cut_windows, log_contrast, untrained
from matcap.statistics.compare import FilterBank, FilterBankConfig

WIDTH, HEIGHT, WINDOW = 96, 64, 48
SETUP = FlashSetup(fov=65.0, offset=(0.1, 0.05, 0.0), intensity=(6.0, 6.0, 6.0))
COARSE = CoarseFit((0.4, 0.3, 0.2), 0.04, 0.5, SETUP, 0.0)
CODE = torch.zeros(CODE_SIZE)
CONFIG = DecoderConfig(noise_channels=4, widths=(6, 8, 8, 8, 8))


def photograph():
    """(3, HEIGHT, WIDTH) radiance of blotches four texels wide."""
    wide = torch.randn(1, 6, HEIGHT + 4, WIDTH + 4, generator=torch.Generator().manual_seed(5))
    blotches = torch.nn.functional.avg_pool2d(wide, 4, 1)[0, :, :HEIGHT, :WIDTH] * 4.0
    mean = torch.tensor([*COARSE.diffuse, COARSE.specular, COARSE.roughness]).logit()
    raw = torch.cat([mean[:, None, None] + 0.4 * blotches[:5], 0.2 * blotches[5:]])
    return render_rectified(maps_from_raw(raw, 2.0 / WIDTH), SETUP)


def scene():
    """That photograph, cut into windows."""
    plane = plane_of(photograph(), torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    bank = FilterBank(FilterBankConfig(sizes=(3,), filters=8, levels=3))
    windows = cut_windows(plane, bank, WINDOW)
    return PhotographTarget(windows, SETUP, plane.encoding, bank, (), plane.texel_size)


def start(seed=0):
    """An untrained decoder around the coarse fit."""
    contrast = log_contrast(photograph(), torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    return untrained(CONFIG, COARSE, contrast, seed)


def tune(report=lambda *_: None, *, decoder=None, seen=None, **settings):
    """Fine-tune; gives Tuned."""
    asked = TuneSettings(**{"steps": 40, "half_precision": False, **settings})
    return finetune(decoder or start(), CODE, seen or scene(), asked, report)
