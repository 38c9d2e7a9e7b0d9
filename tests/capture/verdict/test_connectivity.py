"""Connectivity of a net of lines, of its inverse, and of noise of the same spectrum."""

import cv2
import numpy as np
import pytest

from matcap.capture.verdict.connectivity import connectivity

SIZE = (512, 768)
SEEN = np.ones(SIZE, bool)


def net(seed, size=SIZE, cell=24):
    """Dark lines between the bright cells of random points [worley1996]."""
    rng = np.random.default_rng(seed)
    points = np.ones(size, np.uint8)
    count = size[0] * size[1] // cell**2
    points[rng.integers(0, size[0], count), rng.integers(0, size[1], count)] = 0
    _, label = cv2.distanceTransformWithLabels(
        points, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    edges = np.zeros(size, np.uint8)
    edges[:, 1:] |= label[:, 1:] != label[:, :-1]
    edges[1:] |= label[1:] != label[:-1]
    far = cv2.distanceTransform(1 - edges, cv2.DIST_L2, 5)
    return -np.exp(-((far / 3.0) ** 2)).astype(np.float32)


def scrambled(picture, seed):
    """The same power spectrum with the phases of noise."""
    noise = np.random.default_rng(seed).normal(size=picture.shape)
    phases = np.exp(1j * np.angle(np.fft.rfft2(noise)))
    return np.fft.irfft2(np.abs(np.fft.rfft2(picture)) * phases, picture.shape).astype(np.float32)


def test_another_part_of_a_net_hangs_together_alike():
    before, after = connectivity((net(1), net(2)), SEEN)
    assert before > 1.5 and abs(after - before) < np.log(3.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_net_with_the_phases_of_noise_is_none(sign):
    before, after = connectivity((sign * net(1), sign * scrambled(net(1), 3)), SEEN)
    assert sign * before > 1.5 and abs(after) < 0.6
    assert abs(after - before) > np.log(8.0)


def test_bright_lines_count_against_dark_ones():
    dark, bright = connectivity((net(1), -net(1)), SEEN)
    assert bright == pytest.approx(-dark, abs=0.1)


def test_pictures_of_any_width_are_compared_at_one():
    fine = tuple(cv2.resize(net(n, (768, 1024)), (2048, 1536)) for n in (1, 2))
    small = connectivity((net(1, (768, 1024)), net(2, (768, 1024))), np.ones((768, 1024), bool))
    assert connectivity(fine, np.ones((1536, 2048), bool)) == pytest.approx(small, abs=0.2)


def test_only_what_is_seen_is_compared():
    after = net(1)
    after[:, :384] = scrambled(net(1), 3)[:, :384]
    before, same = connectivity((net(1), after), np.arange(768)[None, :].repeat(512, 0) >= 384)
    assert same == before
    assert connectivity((net(1), after), ~SEEN) is None
    tiny = net(1)[:100]
    assert connectivity((tiny, tiny), SEEN[:100]) is None
