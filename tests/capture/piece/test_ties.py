"""What gloss may go with: lightness, colour, and roughness with relief's bands."""

from __future__ import annotations

import numpy as np
import torch

from matcap.capture.piece.ties import ties


def _noise(seed: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((40, 60))).float()


def test_features_are_lightness_and_colour_apart() -> None:
    light, orange = _noise(0), _noise(1).sign()
    grey = (0.2 * light).exp() * 0.2
    diffuse = torch.stack([grey * (0.3 * orange * k).exp() for k in (1.0, 0.0, -1.0)])
    found = ties(diffuse)
    assert found.features.shape == (2, 40, 60)
    for feature, truth in zip(found.features, (light, orange), strict=True):
        both = torch.stack([feature.flatten(), truth.flatten()])
        assert abs(float(torch.corrcoef(both)[0, 1])) > 0.98
        assert abs(float(feature.mean())) < 1e-3
    assert abs(found.lightness - 0.2) < 0.01
    assert abs(found.colour - 0.3 * 2**0.5) < 0.02


def test_a_grey_even_material_is_believed_to_be_tied_to_nothing_but_relief() -> None:
    bands = torch.stack([_noise(k) for k in range(7)])
    found = ties(torch.full((3, 40, 60), 0.3), bands)
    assert bool(torch.isfinite(found.features).all())
    of_specular, of_roughness = found.deviations()
    assert len(of_specular) == 2
    assert len(of_roughness) == len(found.features) == 2 + 3
    assert max(of_specular + of_roughness[:2]) < 1e-5
    assert min(of_roughness[2:]) > 0.05


def test_specks_count_for_no_more_than_a_few_deviations() -> None:
    speck = torch.full((3, 40, 60), 0.01)
    speck[:, 7, 9] = 0.9
    assert float(ties(speck).features.abs().max()) <= 3.0
