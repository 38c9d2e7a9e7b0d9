"""Tuned constants of the field by example, one frozen dataclass a stage.

Measured in docs/notes/field.md. Constants that the stored index or kernel.c depend on are in the
modules that use them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FeatureSettings:
    """Features of an exemplar's planes (features.py).

    Attributes:
        unit: steps per standard deviation; four deviations fit into LIMIT.
        unseen: lower limit of a plane's standard deviation, in the plane's unit; below it the plane
            is not visible, and must not be amplified.
        weights: of planes. Height is visible through its slopes only; its weight makes patches join
            at equal heights.
    """

    unit: float = 32.0
    unseen: tuple[float, ...] = (0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02, 0.2)
    weights: tuple[float, ...] = (1.0, 1.0, 1.0, 0.7, 1.0, 1.0, 1.0, 0.5)


FEATURE = FeatureSettings()


@dataclass(frozen=True)
class AppearanceSettings:
    """Appearance vectors (appearance.py).

    Attributes:
        fall_off: f of the neighbourhood's weights exp(-r^2 / f), in squared steps.
        samples: neighbourhoods that the PCA is computed from.
        clipped: share of places whose first component exceeds appearance.LARGEST.
    """

    fall_off: float = 8.0
    samples: int = 20_000
    clipped: float = 0.002


APPEARANCE = AppearanceSettings()


@dataclass(frozen=True)
class SimilarSettings:
    """Search for candidates (candidates.py).

    Attributes:
        rounds: more find better candidates and take longer.
        lines: random directions in a round.
        steepest: largest component of a direction.
    """

    rounds: int = 4
    lines: int = 2
    steepest: int = 100


SIMILAR = SimilarSettings()


@dataclass(frozen=True)
class LatticeFieldSettings:
    """Measurement of a lattice and its patches (lattice.py).

    Attributes:
        bins: of a turn, for the search for joints.
        slopes: planes that are left out there, as they vary most at joints.
        patch: least size of a patch of whole cells, texels.
        smaller: factor by which patches shrink until they fit the exemplar.
        window: standard deviation of the Gaussian window of a phase, periods; less in small
            exemplars.
        fewest: least number of periods across an exemplar.
        faint: added to a plane's power, squared features.
        lag: distance at which coherence is measured, window deviations.
        steadiest: upper limit of a plane's coherence, so that no plane dominates.
        rounds: iterations, as a window smooths phase offsets.
    """

    bins: int = 24
    slopes: tuple[int, int] = (5, 6)
    patch: int = 48
    smaller: float = 0.8
    window: float = 1.5
    fewest: float = 3.0
    faint: float = 1e-9
    lag: float = 2.0
    steadiest: float = 0.98
    rounds: int = 3


LATTICE = LatticeFieldSettings()


@dataclass(frozen=True)
class IndexSettings:
    """Candidates and penalties of an exemplar (index.py).

    Attributes:
        least_steps: least distance between a place and its candidate, grid steps.
        least_texels: likewise, texels.
        fineness: least number of places along the shorter side of a lattice's patch.
        unique: ratio of a candidate's distance to the median above which a place is unique.
        unique_level: level at which that is measured; neighbourhoods of some twenty texels.
        least_trust: added to a map's confidence before the logarithm.
        trusted: quantile of the confidence that places are compared with.
        slack: confidence below that quantile without a penalty.
        doubted: confidence below that quantile at which the penalty is largest.
        free: least share of places without a penalty. More uses places of wrong maps, less has too
            few places to choose from.
    """

    least_steps: int = 4
    least_texels: int = 8
    fineness: int = 16
    unique: float = 12.0
    unique_level: int = 2
    least_trust: float = 0.02
    trusted: float = 0.8
    slack: float = 0.05
    doubted: float = 0.35
    free: float = 0.5


INDEX = IndexSettings()


@dataclass(frozen=True)
class LookupSettings:
    """Tables of the synthesis (lookup.py).

    Attributes:
        ordered: first level at which phase errors have a cost.
        cost_bits: placement cost is penalty^2 * 2^cost_bits: 1.3e8 at the penalty 255, more than
            any seam; 4e5 at 14, as much as a common seam.
    """

    ordered: int = 1
    cost_bits: int = 11


LOOKUP = LookupSettings()


@dataclass(frozen=True)
class PlacementSettings:
    """Patches of the coarsest level (patches.py), and corrections.

    Attributes:
        patch: side of the smallest patches, texels.
        part: least ratio of the exemplar's shorter side to that.
        draws: random places of which the one of least placement cost is taken.
        fitted: random places of which the one that fits its neighbours best is taken.
        along: most places along a border at which patches are compared.
        overlap: steps of the coarsest level by which the largest patch is smaller than the frame.
        passes: of correction at the finest level, and at every coarser one.
    """

    patch: int = 128
    part: int = 2
    draws: int = 4
    fitted: int = 24
    along: int = 32
    overlap: int = 3
    passes: tuple[int, int] = (1, 2)


PLACEMENT = PlacementSettings()


@dataclass(frozen=True)
class BlendSettings:
    """Blending at seams (blend.py).

    Attributes:
        levels: by band, finest first, level of the places that nodes read. Coarser levels save
            time for coarse bands; more bands blend slower drifts of colour.
        measured: level, and places a side, of the square in which seam_correlations are measured.
    """

    levels: tuple[int, ...] = (0, 0, 0, 0, 2, 3)
    measured: tuple[int, int] = (1, 128)

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.levels)


BLEND = BlendSettings()


@dataclass(frozen=True)
class VarietyChoiceSettings:
    """Choice of the variety (variety.py).

    Attributes:
        tried: varieties, highest first; the last is taken if none passes.
        level: level of the synthesised samples. Finer takes longer, coarser shows fewer seams.
        blocks: samples of each variety; one where the exemplar has fewer levels.
        step: texels that are averaged before the correlation.
        near: shortest shift of the correlation, texels; shorter structure fits any patch.
        lost: largest RMS loss of correlation. Random differences give 0.02.
        share: largest loss as a share of the exemplar's RMS correlation, if that is more.
        seams: largest share of texels at seams. Textures without long structure have up to 0.0175,
            others from 0.021 on.
    """

    tried: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)
    level: int = 2
    blocks: int = 2
    step: int = 4
    near: float = 64.0
    lost: float = 0.035
    share: float = 0.5
    seams: float = 0.018


VARIETY = VarietyChoiceSettings()
