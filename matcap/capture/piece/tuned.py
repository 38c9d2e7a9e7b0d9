"""Constants of the exemplar's estimation: one frozen dataclass a stage.

Each number with its unit and what it trades. Measured on simulated and on artists' materials:
docs/notes/capture.md, unless another note is named. Bands are strengths.BANDS, longest first.
"""

from __future__ import annotations

from dataclasses import dataclass

from matcap.flash.penalty import Penalties


@dataclass(frozen=True)
class ReadSettings:
    """Inputs of the network, and the confidence in its prediction.

    Attributes:
        farthest: log radiance; residuals from the uniform material are clipped to it.
        step: slope, and logit of roughness, for differences of radiance.
        coarser: texels a side of which one is worked out: what a uniform material shows is smooth.
        damping: bounds the first-order slope estimate where the sensitivity vanishes.
        doubted_albedo, doubted_specular, doubted_roughness, doubted_slope: expected errors (log,
            log, logit, slope) at which confidence has fallen to 1/e. More trusts what is guessed.
        confidence_around: the long side over the deviation of a neighbourhood's confidence. More
            follows single features, and only plain places are trusted.
        spread_of_light: texels, deviation of the blur of light from a clipped texel.
        unlit, unlit_around: where a neighbourhood (deviation in texels) has less light than this,
            of 1 at clipping, a photograph of 8 bits has its last codes, a RAW the sensor's noise.
    """

    farthest: float = 3.0
    step: float = 0.03
    coarser: int = 4
    damping: float = 0.1
    doubted_albedo: float = 0.3
    doubted_specular: float = 0.6
    doubted_roughness: float = 0.6
    doubted_slope: float = 0.15
    confidence_around: float = 12.0
    spread_of_light: float = 1.5
    unlit: float = 1e-3
    unlit_around: float = 8.0


@dataclass(frozen=True)
class NoiseSettings:
    """Noise model of the channels.

    Attributes:
        codes: of 255, deviation: what development leaves a channel off by. More takes dark texture
            for noise.
        around: texels, deviation: of what counts as a neighbourhood.
        alike: of log radiance: channels with less noise count alike.
        darkest: linear radiance.
        block, plain: texels a side, and the share of blocks that is taken to be plain.
    """

    codes: float = 1.0
    around: float = 8.0
    alike: float = 0.1
    darkest: float = 1e-5
    block: int = 8
    plain: float = 0.1


@dataclass(frozen=True)
class StrengthSettings:
    """Measurement of relief and albedo energies (strengths.py), and how far it is followed.

    Attributes:
        window, stride: texels. Larger windows resolve longer waves, and fewer fit.
        seen: share of a window that must be seen; energies are raised by what is not. At 0.98 a
            photograph with sparkles has no window left.
        linear: |d log L/d slope| at which a window's weight drops to one half; beyond it the
            first-order shading model fails, and near a highlight it turns within a window. A
            cut-off at 0.8 or 2 instead is the same within 1 %.
        rounds: of reweighting: energies scatter in proportion to themselves.
        fewest: windows, for three unknowns.
        scatter: factor on errors: windows overlap and all directions look at the same ones.
        common: share of albedo's energy that windows differ by in all directions alike. At 0 what
            light dilutes passes for relief (a weave's slopes are measured three times too large).
        diluted: likewise with the squared diffuse share, for all windows together. Dark gaps are
            diluted far more than by the share itself.
        disagreed: share of the difference of two estimates that counts as deviation.
        response_around: texels, deviation of the blur of the sensitivity.
        together, each_band: deviations of the logarithm of energies that networks draw from true
            ones: of all bands, and of each beside. Half or twice as much hardly matters.
        posterior_reach, posterior_step: range and step of the log factors tried (equalise.py).
        least_energy: squared slope.
        even_around: texels, deviation of a neighbourhood. Less evens out a cell beside its groove
            (at 20 a leather loses 0.1 floors and a cloth gains as much), more leaves arcs around
            the flash's mirror point.
        even_directions: that waves are parted into.
        even_margin: texels that a band goes on for beyond its border, mirrored.
        even_least, even_most: waves are not weakened or strengthened more by their place.
        even_sharpness: power of the sensitivity: more counts only where the light runs along.
        even_rounds: of bringing bands to their strengths: they share waves at their borders.
        strongest: a band's factor; beyond, it has nothing of its own. At 5 leather's finest octave,
            which needed 11, stayed weak.
        least_slope: slope.
    """

    window: int = 128
    stride: int = 64
    seen: float = 0.75
    linear: float = 1.2
    rounds: int = 4
    fewest: int = 8
    scatter: float = 2.0
    common: float = 1.0
    diluted: float = 5.0
    disagreed: float = 0.5
    response_around: float = 24.0
    together: float = 1.5
    each_band: float = 1.0
    posterior_reach: float = 5.0
    posterior_step: float = 0.05
    least_energy: float = 1e-8
    even_around: float = 32.0
    even_directions: int = 8
    even_margin: int = 64
    even_least: float = 0.25
    even_most: float = 10.0
    even_sharpness: float = 3.0
    even_rounds: int = 3
    strongest: float = 30.0
    least_slope: float = 1e-4


@dataclass(frozen=True)
class KindSettings:
    """Classification of texels as metal or dielectric (classes.py); docs/notes/gloss.md.

    Attributes:
        around: the long side over the deviation of a neighbourhood that a texel is compared with.
        drawn: logit of metal for a deviation of what goes with the network's. More follows its
            borders, and less the photograph.
        texels: along the short side that kinds are fitted on.
        rounds: of fitting mean parameters and classifying texels.
        albedo, specular, roughness: deviations of levels as read (log, log, logit).
        grey, colour: of a texel's log radiance: what relief and grain leave unexplained, of all
            channels together and apart. Less tears kinds apart by relief.
        patch: of the long side, deviation of a neighbourhood that is classified as one. More rounds
            borders off, less tears kinds apart by relief.
        counts: power of a texel's likelihood: its residuals are not independent.
        least_share: of either kind.
        black, black_deviation: diffuse albedo of metal, and the deviation of its logarithm.
        contrast: log F0 of metal over the rest's, at least; 2.5 as materials are.
        sure: log odds that the rest is none.
        agreed: correlation of the photograph's and the network's classification, below which
            there are no two kinds.
        most_off: of rings' log radiance over `agreed`; beyond, the classes explain too little.
    """

    around: float = 10.0
    drawn: float = 2.0
    texels: int = 128
    rounds: int = 3
    albedo: float = 1.5
    specular: float = 2.0
    roughness: float = 0.35
    grey: float = 1.0
    colour: float = 0.2
    patch: float = 0.002
    counts: float = 3.0
    least_share: float = 0.03
    black: float = 0.004
    black_deviation: float = 0.3
    contrast: float = 1.5
    sure: float = 1.0
    agreed: float = 0.4
    most_off: float = 0.2


@dataclass(frozen=True)
class RefineSettings:
    """Refinement by re-rendering (refine.py).

    Attributes:
        steps: of refinement. More is sharper, and takes as much longer: of granite's finest octave
            0.66, 0.74 and 0.74 are there after 3, 4 and 6.
        slope_step: of slopes, for differences of log radiance.
        least_error, most_error: limits of expected errors.
        least_noise: of log radiance: what is not explained, where the sensor's is less. Less draws
            the sensor's grain into the maps.
        darkest: linear radiance.
        slow: the picture's long side over the deviation of what counts as slow and stays out.
        most: of log radiance a step explains. Gaps between threads are darker than read by more
            than 0.5.
        glare, glare_metal: of log radiance: what a highlight's fit leaves where all light is
            mirrored, by a dielectric and by metal, whose texture is its F0: with 0.5 a brushed
            steel is 2.5 times as far as two samples differ, with 0.15 1.8.
        chroma: deviation of albedo's colour as a share of its lightness's. More takes the sensor's
            noise for the material's.
        stationary: the long side over the deviation of what a stationary sample is even over.
        thinned: texels a side of which one is looked at, where things are smooth.
    """

    steps: int = 5
    slope_step: float = 0.03
    least_error: float = 0.02
    most_error: float = 1.0
    least_noise: float = 0.01
    darkest: float = 1e-5
    slow: float = 12.0
    most: float = 1.5
    glare: float = 0.5
    glare_metal: float = 0.15
    chroma: float = 0.3
    stationary: float = 8.0
    thinned: int = 3


@dataclass(frozen=True)
class AdaptSettings:
    """Texture-statistics fit of the scaling parameters (adapt.py).

    Attributes:
        legs: how far each leg reaches; in between, what relief no longer explains goes back to
            albedo. Short steps at the end: long ones stray by a tenth of relief's strength.
        stepping: share of a leg's seconds that are for steps; the rest is for judging and
            re-rendering what they came to.
        rate: of Adam, in logits and in logarithms of gains.
        betas: of Adam: short memories, for there are few steps.
        windows: a step, of exemplar and of photograph.
        averaged_from: share of the steps after which the rate falls to 0 and iterates are averaged.
        offset_albedo: prior deviation of the logits' mean.
        gain_albedo: prior deviation of the logarithm of albedo's contrast.
        relief, band: how far the logarithm of relief's strength is, and of each band's beside.
        least_deviation: lower limit of that deviation, however well it is measured.
        validation, least_validation: number of validation windows, and the least.
        judging_seed: of their places.
        belief: of the distance of statistics, for a number that is off by its deviation.
        logit_epsilon: of albedo, F0 and roughness: bounds the logit at 0 and 1.
        seen: share of a window that must have been seen; of the best windows, if none has.
        unexplained: of log radiance, that pieces leave of their photographs anyway.
        more_unexplained: times that, or what was left before, at which a leg is not taken. On rust
            1.7, with rings and blue specks; 1.2 at most on 21 real photographs.
        penalties: specks are what was photographed, here.
        contrast_around: texels, deviation of a neighbourhood of albedo's contrast.
        contrast_least, contrast_most: contrast is not lowered or raised more.
        contrast_faintest: of log albedo.
        contrast_unseen: weight of a place for what is there, seen or not.
    """

    legs: tuple[float, ...] = (1.0, 0.35)
    stepping: float = 0.8
    rate: float = 0.06
    betas: tuple[float, float] = (0.8, 0.95)
    windows: int = 3
    averaged_from: float = 0.5
    offset_albedo: float = 0.3
    gain_albedo: float = 0.3
    relief: float = 0.5
    band: float = 0.3
    least_deviation: float = 0.03
    validation: int = 12
    least_validation: int = 3
    judging_seed: int = 1
    belief: float = 0.005
    logit_epsilon: float = 1e-4
    seen: float = 0.95
    unexplained: float = 0.15
    more_unexplained: float = 1.3
    penalties: Penalties = Penalties(outlier=0.0)
    contrast_around: float = 64.0
    contrast_least: float = 0.5
    contrast_most: float = 3.0
    contrast_faintest: float = 1e-4
    contrast_unseen: float = 0.05


@dataclass(frozen=True)
class InpaintSettings:
    """Inpainting of maps under the highlight (transport.py).

    Attributes:
        tried, tried_at_once: blocks for a place of a piece that was adapted, or was not. More finds
            likelier ones and takes as much longer.
        block: texels a side: long enough for pieces of a drawing, short enough to be found.
        overlap: texels that neighbours share.
        trusted: confidence of albedo, as a share of the well seen places', of donors. More inpaints
            places that are seen well enough: at 0.93 wood lost 0.4 floors.
        well_seen: quantile of confidence that counts as well seen.
        most_hidden: share of the picture: more than this no flash hides.
        whole: share of a block that must be trusted.
        wanted: share of a place that is not, for a block to be laid there.
        least: share of all texels below which nothing is inpainted.
        likeness: what a drawing's correlation counts beside the overlap's continuity.
        stronger, shown: times the energy of donor blocks, beyond which a place keeps
            what is there, if so large a share of it shows at all: a scratch stays, and so does bare
            metal that only the highlight shows. More inpaints more, and loses those.
        thinned: texels a side of which one is lit.
        farthest: squared, in deviations: differences beyond it are edges that do not meet.
        reach: texels, over which the two sides of a seam come together.
        darkest: linear radiance.
    """

    tried: int = 250
    tried_at_once: int = 40
    block: int = 48
    overlap: int = 12
    trusted: float = 0.75
    well_seen: float = 0.75
    most_hidden: float = 0.2
    whole: float = 0.95
    wanted: float = 0.25
    least: float = 2e-4
    likeness: float = 0.7
    stronger: float = 2.0
    shown: float = 0.5
    thinned: int = 4
    farthest: float = 4.0
    reach: float = 24.0
    darkest: float = 1e-4


@dataclass(frozen=True)
class FinestSettings:
    """Detail transfer from the photograph (finest.py).

    Attributes:
        darkest: linear radiance.
        most: of log radiance, that is detail.
        hidden: squared share of matte light at which half of what shows is taken for albedo's.
        rounds: of bringing albedo to the photograph.
        relief_at_most: share of the finest bands' energy that is relief's. Half of it instead:
            leather 8.1 floors for 7.4, and sharper than photographed.
        least_ratio, most_ratio: of an octave's energy of slopes to the one before.
        thinned: texels a side of which one is looked at, where things are smooth.
    """

    darkest: float = 1e-5
    most: float = 1.0
    hidden: float = 0.1
    rounds: int = 2
    relief_at_most: float = 0.25
    least_ratio: float = 0.05
    most_ratio: float = 1.0
    thinned: int = 4


READ = ReadSettings()
NOISE = NoiseSettings()
STRENGTH = StrengthSettings()
KINDS = KindSettings()
REFINE = RefineSettings()
ADAPT = AdaptSettings()
INPAINT = InpaintSettings()
FINEST = FinestSettings()


@dataclass(frozen=True)
class BandSettings:
    """Octave bands of a plane (smooth.py); docs/notes/capture.md.

    Attributes:
        coarser: texels a side that are one, for wide blurs. More is quicker, and shows as cells.
        soft: octaves: half of what bands share at their borders. Less rings.
    """

    coarser: int = 8
    soft: float = 0.25


BAND = BandSettings()
