"""Where features are found in a photograph."""

from dataclasses import replace

import cv2
import numpy as np

from matcap.flash.registration.keypoints import KeypointSettings, even_contrast, find_keypoints
from matcap.photo.photo import Photo


def _grain():
    noise = np.random.default_rng(0).normal(size=(180, 240))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    pixels = np.exp(0.3 * smooth / smooth.std()).astype(np.float32)[..., None].repeat(3, 2) / 4.0
    return Photo(pixels, pixels.max(-1) >= 1.0, 65.0, "exif", False, "grain", (240, 180))


def test_features_lie_where_they_are_whichever_way_the_picture_is_held():
    photo = _grain()
    turned = replace(photo, pixels=np.ascontiguousarray(photo.pixels[::-1, ::-1]))
    settings = KeypointSettings()
    one, other = (find_keypoints(each, even_contrast, settings) for each in (photo, turned))
    pairs = cv2.BFMatcher(crossCheck=True).match(one.described, other.described)
    first = one.image[:, [pair.queryIdx for pair in pairs]]
    second = -other.image[:, [pair.trainIdx for pair in pairs]]
    off = np.median(first - second, 1) / 2.0 / one.pixel
    np.testing.assert_allclose(off, 0.0, atol=0.02)
