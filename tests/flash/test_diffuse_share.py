"""A white lobe lowers the colour contrast of texture by the diffuse share; a cone does not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from uniform import a_setup, photograph

from matcap.flash.coarse.fit import diffuse_share_of, fit_coarse
from matcap.flash.diffuse_share import measure_diffuse_share

WHITE = np.ones(3)
SIZE = (384, 512)
CENTRE = (0.1, -0.05)


def radius():
    u = (np.arange(SIZE[1]) + 0.5) * 2.0 / SIZE[1] - 1.0
    v = (SIZE[0] - 2.0 * (np.arange(SIZE[0])[:, None] + 0.5)) / SIZE[1]
    return np.hypot(u - CENTRE[0], v - CENTRE[1])[..., None]


def coloured_texture(contrast=0.4, seed=0):
    """(H, W, 3) albedo of independent channels, of a saturated mean."""
    noise = np.random.default_rng(seed).standard_normal((*SIZE, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.array([0.4, 0.2, 0.1]) * np.exp(contrast * smooth / smooth.std())


def measured(light, **options):
    light = light.astype(np.float32)
    return measure_diffuse_share(light, light.max(-1) < 1.0, CENTRE, developed=False, **options)


def lobe(peak=0.4):
    return peak * np.exp(-np.square(radius() / 0.4))


def test_scatter_falls_by_the_diffuse_share():
    albedo = coloured_texture()
    share = measured(0.5 * albedo + lobe())
    true = 0.5 * albedo.mean() / (0.5 * albedo.mean() + lobe()[..., 0])
    at = np.array(
        [
            cv2.remap(true.astype(np.float32), *pixels_of(each), cv2.INTER_LINEAR).mean()
            for each in np.moveaxis(share.image, 1, 0)
        ]
    )
    log_scatter = share.log_scatter(WHITE)
    assert at[0] < 0.4
    assert np.exp(log_scatter - log_scatter[-1]) * at[-1] == pytest.approx(at, abs=0.06)


def pixels_of(image):
    u, v = (plane[None] for plane in image)
    column = (u + 1.0) * SIZE[1] / 2.0 - 0.5
    row = (SIZE[0] - v * SIZE[1]) / 2.0 - 0.5
    return column.astype(np.float32), row.astype(np.float32)


@pytest.mark.parametrize("what", ["cone", "glints", "coloured flash"])
def test_scatter_does_not_depend_on(what):
    """Glints are strong white light of small area, which log ratios of channels would follow."""
    albedo, rng = coloured_texture(), np.random.default_rng(1)
    light, colour = 0.4 * albedo + lobe(0.2), WHITE
    plain = measured(light).log_scatter(WHITE)
    if what == "cone":
        light = light * np.exp(-2.0 * radius() ** 2)
    elif what == "coloured flash":
        colour = np.array([1.2, 1.0, 0.7])
        light = light * colour
    else:
        glints = np.exp(cv2.GaussianBlur(rng.standard_normal(SIZE), (0, 0), 1.5) * 2.0)
        light = light + lobe(0.2) * (glints / glints.mean() - 1.0)[..., None]
    moved = measured(light).log_scatter(colour) - plain
    assert np.abs(moved - moved.mean()).max() < 0.12


def test_its_deviation_is_larger_where_it_knows_less():
    light = 0.5 * coloured_texture() + lobe()
    plain = measured(light)
    noise = 0.05 * np.random.default_rng(2).standard_normal((*SIZE, 3)).astype(np.float32)
    assert (measured(light, noise=noise).deviation > plain.deviation).all()
    clipped = measured(light + lobe(0.45))
    assert len(clipped.deviation) < len(plain.deviation) or (
        clipped.deviation[0] > plain.deviation[0]
    )
    faint = measured(0.5 * coloured_texture(0.02) + lobe())
    assert faint is None or (faint.deviation > plain.deviation).all()


def test_without_colour_nothing_is_measured():
    grey = coloured_texture().mean(-1, keepdims=True) * np.ones(3)
    assert measured(0.5 * grey + lobe()) is None


def test_a_cone_is_no_lobe_where_texture_keeps_its_contrast():
    """A satin black surface and a matte one under a narrow cone look alike without texture."""
    setup = replace(a_setup(intensity=6.0), vignetting=1.5, vignetting_quartic=0.5)
    photo = photograph(setup, diffuse=(0.3, 0.25, 0.2), roughness=0.9, radiometric=False)
    texture = cv2.resize(coloured_texture(0.5), photo.pixels.shape[1::-1])
    texture = texture / texture.mean((0, 1))
    pixels = (photo.pixels * texture).astype(np.float32).clip(0.0, 1.0)
    textured = replace(photo, pixels=pixels, clipped=(pixels >= 1.0).any(2))
    scatter = diffuse_share_of(textured, None).log_scatter(WHITE)
    assert np.abs(scatter - scatter.mean()).max() < 0.25
    plain, fit = fit_coarse(photo), fit_coarse(textured)
    assert fit.roughness > max(0.6, plain.roughness - 0.05) and np.mean(fit.diffuse) > 0.15
