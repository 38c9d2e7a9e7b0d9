"""A photograph on its plane, and the colours in which it is compared."""

import torch

from matcap.flash.plane import plane_of


def photographed(burnt: bool):
    """Faint texture; with a burnt half whose texels flicker far above the rest."""
    generator = torch.Generator().manual_seed(0)
    linear = 0.1 * torch.exp(0.05 * torch.randn(3, 96, 256, generator=generator))
    valid = torch.ones(96, 256, dtype=torch.bool)
    if burnt:
        checks = (torch.arange(96)[:, None] + torch.arange(128)) % 2
        linear[:, :, 128:] = 0.5 + 0.5 * checks
        valid[:, 128:] = False
    return linear, valid


def test_burnt_texels_say_nothing_of_the_encoding():
    """Neither of what middle grey is, nor of how much the texture varies."""
    sound, burnt = (plane_of(*photographed(with_burnt)) for with_burnt in (False, True))
    left = sound.linear[:, :, :128]
    assert burnt.encoding.median == float(left.mean(0).median())
    # Away from the border, where shading's means reach over it.
    for plane in (sound, burnt):
        deviation = plane.encoded()[:, :, :64].std()
        assert 0.5 < float(deviation) < 1.5


def test_where_hardly_anything_was_seen_all_is_looked_at():
    linear, valid = photographed(burnt=True)
    assert plane_of(linear, torch.zeros_like(valid)).encoding.median == float(
        linear.mean(0).median()
    )
