"""What is tuned of the field by example: one frozen dataclass a stage.

Each number with its unit and what it trades; measured in docs/notes/field.md. Sizes that the
stored index or the integers of kernel.c are laid out by stand where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FeatureSettings:
    """What pieces are compared by.

    Attributes:
        unit: features to a standard deviation: four of them fit.
        unseen: what is fainter is not seen and not amplified, in each plane's own numbers: slopes
            show from about a degree on, height only as their sum over some ten texels.
        weights: of planes. Height is seen by its slopes alone; it counts so that what is joined
            lies equally high.
    """

    unit: float = 32.0
    unseen: tuple[float, ...] = (0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02, 0.2)
    weights: tuple[float, ...] = (1.0, 1.0, 1.0, 0.7, 1.0, 1.0, 1.0, 0.5)


FEATURE = FeatureSettings()


@dataclass(frozen=True)
class AppearanceSettings:
    """How neighbourhoods become a few numbers.

    Attributes:
        fall_off: of the weights, in squared steps of the neighbourhood.
        samples: neighbourhoods that the components are taken from.
        clipped: share of the largest component that may exceed appearance.LARGEST.
    """

    fall_off: float = 8.0
    samples: int = 20_000
    clipped: float = 0.002


APPEARANCE = AppearanceSettings()


@dataclass(frozen=True)
class SimilarSettings:
    """How similar places are looked for.

    Attributes:
        rounds: more find nearer ones, and take longer.
        lines: of a round.
        steepest: components of a line's direction.
    """

    rounds: int = 4
    lines: int = 2
    steepest: int = 100


SIMILAR = SimilarSettings()


@dataclass(frozen=True)
class OrderSettings:
    """How regular order is measured where it bends.

    Attributes:
        bins: to a turn, where cells are compared.
        slopes: planes that vary most at joints, which are edges, and so hide them.
        piece: texels: cells smaller than this are laid several together.
        smaller: pieces of cells that are too large for the exemplar shrink by this.
        window: periods: standard deviation of the window that a phase is measured in; less where
            an exemplar has room for less.
        fewest: periods across an exemplar: of a check larger than a third of it nothing is kept.
        faint: of squared features: a plane may be flat.
        lag: windows' deviations: so far apart they hardly see the same cells.
        steadiest: upper limit of a plane's coherence, so that no single plane decides alone.
        rounds: a window smooths bends away: what is left of them is measured again.
    """

    bins: int = 24
    slopes: tuple[int, int] = (5, 6)
    piece: int = 48
    smaller: float = 0.8
    window: float = 1.5
    fewest: float = 3.0
    faint: float = 1e-9
    lag: float = 2.0
    steadiest: float = 0.98
    rounds: int = 3


ORDER = OrderSettings()


@dataclass(frozen=True)
class IndexSettings:
    """How the k-coherence candidates and the placement cost of an exemplar are computed.

    Attributes:
        least_steps: grid steps between a place and its candidates, at least, and ...
        least_texels: ... texels, at least.
        fineness: places of the coarsest level along the shorter side of a lattice's piece.
        unique: times the median distance to what is most similar: a mark that occurs once, ...
        unique_level: ... measured at this pyramid level, over some twenty texels.
        least_trust: of a map: what was not seen is drawn by example.
        trusted: quantile of confidence that a place is held against.
        slack: confidence below it up to which a place is as good: steps of it lie between most
            parts of a photograph.
        doubted: likewise, at which it is as reluctant as can be.
        free: share that costs nothing at least, however little it is trusted: more draws faults in,
            less draws from scraps.
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
    """Placement cost, added to the mismatch of appearances.

    Attributes:
        ordered: levels from this one on keep to the order.
        cost_bits: a place of full reluctance costs 255^2 * 2^11 = 1.3e8, more than any seam; one a
            little less trusted than most, 14 of 255, 4e5, as a common seam.
    """

    ordered: int = 1
    cost_bits: int = 11


LOOKUP = LookupSettings()


@dataclass(frozen=True)
class PlacementSettings:
    """How pieces are laid and corrected.

    Attributes:
        piece: texels along a side of the pieces that the coarsest level begins with, ...
        part: ... at most the exemplar's shorter side over this.
        draws: pieces that each is the cheapest of.
        fitted: pieces that each larger one is the best continuation of its neighbours of.
        along: places that a border is compared at, at most.
        overlap: steps of the coarsest level that the largest pieces leave of the exemplar's frame.
        passes: of correction at the finest level, and at every coarser one.
    """

    piece: int = 128
    part: int = 2
    draws: int = 4
    fitted: int = 24
    along: int = 32
    overlap: int = 3
    passes: tuple[int, int] = (1, 2)


PLACEMENT = PlacementSettings()


@dataclass(frozen=True)
class BlendSettings:
    """How maps join at seams (blend.py).

    Attributes:
        levels: of places, that votes of every band are taken from, the finest band first. Of the
            finest places where a seam is joined where it lies; coarser ones differ there alone, and
            are there around every block anyway. More bands join slower drifts of colour.
        measured: level, and places a side of a square of it, whose seams measure how far votes that
            differ correlate.
    """

    levels: tuple[int, ...] = (0, 0, 0, 0, 2, 3)
    measured: tuple[int, int] = (1, 128)

    @property
    def bands(self) -> int:
        """How many."""
        return len(self.levels)


BLEND = BlendSettings()


@dataclass(frozen=True)
class TearingSettings:
    """How the variety of a field is chosen.

    Attributes:
        tried: varieties, the most random first; the last where all tear too much.
        level: that blocks are synthesised down to: finer takes longer, coarser sees fewer seams.
        blocks: of each variety: more are less left to chance, and take longer. One where a lattice
            calls for a finer level.
        step: texels that are compared as one.
        near: texels: correlation at shorter shifts is grain, which pieces of any size keep.
        torn: mean correlation over longer shifts that may be lost: chance gives 0.02.
        share: of the exemplar's that may be lost, where it has more.
        seams: share of texels at borders. What is torn no more than it must be has up to 0.0175,
            what hangs together 0.021 and more.
    """

    tried: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)
    level: int = 2
    blocks: int = 2
    step: int = 4
    near: float = 64.0
    torn: float = 0.035
    share: float = 0.5
    seams: float = 0.018


VARIETY = TearingSettings()
