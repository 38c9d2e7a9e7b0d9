"""Scratches across a texture that no texel of them exceeds."""

import cv2
import numpy as np
import pytest

from matcap.statistics.streaks import streaks

HEIGHT, WIDTH = 192, 256
KNOWN = np.ones((HEIGHT, WIDTH), np.bool_)
ENDS = (60, 40), (150, 130)  # x, y


def grain(blurs, seed=1):
    """Noise of deviation 1, blurred along x and y."""
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), sigmaX=blurs[0], sigmaY=blurs[1])
    return blurred / blurred.std()


def scratched(plane, contrast):
    """The plane with a scratch, and where its middle is."""
    line, middle = np.zeros((2, *plane.shape), np.uint8)
    cv2.line(line, *ENDS, 1, 3)
    cv2.line(middle, *ENDS, 1, 1)
    return (plane + contrast * line).astype(np.float32), middle > 0


@pytest.mark.parametrize("blurs", [(1.0, 1.0), (12.0, 1.0), (1.0, 12.0)], ids=["dots", "x", "y"])
def test_a_scratch_stands_out_and_a_texture_does_not(blurs):
    plain = grain(blurs)
    assert (streaks(plain, KNOWN) > 7.0).mean() < 0.002
    marked, line = scratched(plain, 2.5)
    found = streaks(marked, KNOWN)
    assert (found[line] > 7.0).mean() > 0.7
    near = cv2.dilate(line.astype(np.uint8), np.ones((41, 41), np.uint8)) > 0
    assert (found[~near] > 7.0).mean() < 0.002
    # No texel of it is as far from the mean as the brightest of the texture.
    assert marked[line].mean() < plain.max()


def test_medians_are_of_known_texels():
    plane = grain((1.0, 1.0))
    plane[:, WIDTH // 2 :] *= 5.0
    known = KNOWN.copy()
    known[:, WIDTH // 2 :] = False
    left = np.s_[:, : WIDTH // 2 - 20]
    alone = streaks(np.ascontiguousarray(plane[:, : WIDTH // 2]), KNOWN[:, : WIDTH // 2])
    assert streaks(plane, known)[left] == pytest.approx(alone[left], rel=0.15)
