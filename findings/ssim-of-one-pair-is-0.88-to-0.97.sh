#!/usr/bin/env bash
# SSIM of one pair of textures is 0.88 to 0.97 by the defaults of four libraries, and jumps with the size.
#
# Behaviour: the paper's window is a Gaussian of 1.5 pixels. scikit-image takes a plain window of 7 pixels
# and the sample covariance, sewar a plain one of 8 pixels. piq halves images whose shorter side is
# at least 384 pixels first (downsample=True). torchmetrics takes the range of the two images for that
# of the data, and ignores kernel_size while gaussian_kernel is True, also its default.
# With the options for it all are at 0.878. Each option is documented; no result says which was used.
# Why it matters: SSIM of maps and re-renderings from different papers or tools, and of crops and whole
# images with one tool, cannot be compared; the gap is larger than those between methods.
# Seen on 2026-12-01:
#   scikit-image 0.26.0, sewar 0.4.10, piq 0.8.0, torchmetrics 1.9.0
#   noise of 0.05, 512 pixels: scikit-image 0.896, sewar 0.911, piq 0.969, torchmetrics 0.878
#   with the paper's options: scikit-image 0.878, piq 0.878, torchmetrics 0.878
#   piq at 380 and 384 pixels: 0.878, 0.969
#   contrast a tenth, noise too: torchmetrics 0.879 by default, 0.978 with data_range=1
#   torchmetrics with kernel_size 5 and 11: the same
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 sewar==0.4.10 piq==0.8.0 torchmetrics==1.9.0 \
    torch==2.14.1 torchvision==0.29.1 scipy==1.17.1 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np, piq, sewar, torch
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity
from torchmetrics.functional.image import structural_similarity_index_measure

random = np.random.default_rng(0)
texture = gaussian_filter(random.standard_normal((512, 512)), 1, mode="wrap")
texture = np.clip(0.5 + 0.12 * texture / texture.std(), 0, 1)
noisy = np.clip(texture + 0.05 * random.standard_normal(texture.shape), 0, 1)
pair = [torch.tensor(image, dtype=torch.float32)[None, None] for image in (noisy, texture)]


def by_piq(size=512, **options):
    return float(piq.ssim(*(image[..., :size, :size] for image in pair), **options))


def by_torchmetrics(contrast=1.0, **options):
    return float(structural_similarity_index_measure(*(0.5 + contrast * (image - 0.5) for image in pair), **options))


def by_scikit_image(**options):
    return float(structural_similarity(texture, noisy, data_range=1, **options))


paper = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
defaults = {"scikit-image": by_scikit_image(), "sewar": float(sewar.ssim(texture, noisy, MAX=1.0)[0]),
            "piq": by_piq(), "torchmetrics": by_torchmetrics()}
alike = {"scikit-image": by_scikit_image(**paper), "piq": by_piq(downsample=False), "torchmetrics": by_torchmetrics(data_range=1.0)}
sizes = by_piq(380), by_piq(384)
faint = by_torchmetrics(0.1), by_torchmetrics(0.1, data_range=1.0)
kernels = [by_torchmetrics(data_range=1.0, kernel_size=size) for size in (5, 11)]
print(", ".join(f"{name} {version(name)}" for name in defaults))
print("noise of 0.05, 512 pixels: " + ", ".join(f"{name} {value:.3f}" for name, value in defaults.items()))
print("with the paper's options: " + ", ".join(f"{name} {value:.3f}" for name, value in alike.items()))
print("piq at 380 and 384 pixels: {:.3f}, {:.3f}".format(*sizes))
print("contrast a tenth, noise too: torchmetrics {:.3f} by default, {:.3f} with data_range=1".format(*faint))
print("torchmetrics with kernel_size 5 and 11: " + ("the same" if kernels[0] == kernels[1] else "not the same"))
assert np.allclose(list(defaults.values()), [0.896, 0.911, 0.969, 0.878], atol=2e-3), "changed"
assert np.allclose(list(alike.values()), 0.878, atol=1e-3) and np.allclose(sizes, [0.878, 0.969], atol=2e-3), "changed"
assert faint[1] - faint[0] > 0.09 and kernels[0] == kernels[1], "changed"
PY
