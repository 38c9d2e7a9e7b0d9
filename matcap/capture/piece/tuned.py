"""Constants of the exemplar's estimation: one frozen dataclass per stage.

Each constant has its unit and the effect of larger or smaller values, measured on simulated and
artists' materials (docs/notes/capture.md, unless another note is named). NSD is the normalised
style distance. Bands are strengths.BANDS, longest wavelength first.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadSettings:
    """Inputs of the network, and the confidence in its prediction.

    Attributes:
        farthest: log radiance; residuals from the uniform material are clipped to +-this.
        step: step of slope and of logit roughness in finite differences of radiance.
        coarser: subsampling, texels, of renderings of the uniform material, which are smooth.
        damping: regularises the first-order slope estimate where the sensitivity vanishes.
        doubted_albedo, doubted_specular, doubted_roughness, doubted_slope: expected errors (log,
            log, logit, slope) at which confidence is 1/e. Larger values trust uncertain maps.
        confidence_around: the picture's long side over the standard deviation of the blur of
            confidence. Larger values trust only texels without features.
        spread_of_light: texels, standard deviation of the blur of clipping.
        unlit, unlit_around: radiance (1 at clipping) below which a Gaussian neighbourhood (standard
            deviation in texels) is unlit: it has the lowest 8-bit codes, or a RAW's noise.
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
        codes: standard deviation of a developed channel's noise, in codes of 255. Larger values
            take dark texture for noise.
        around: texels, standard deviation of local averages.
        alike: log radiance added in quadrature to the noise before channels are weighted by it.
        darkest: linear radiance below which logarithms are clamped.
        block, plain: side of blocks in texels, and the share of blocks assumed to have no texture.
    """

    codes: float = 1.0
    around: float = 8.0
    alike: float = 0.1
    darkest: float = 1e-5
    block: int = 8
    plain: float = 0.1


@dataclass(frozen=True)
class StrengthSettings:
    """Measurement of relief and albedo energies (strengths.py) and their use (equalise.py).

    Attributes:
        window, stride: side and spacing of windows, texels. Larger windows resolve longer waves,
            but fewer fit.
        seen: least visible share of a window; its energy is divided by that share. At 0.98 a
            photograph with sparkles has no window left.
        linear: |d log L/d slope| at which a window's weight drops to one half; beyond it the
            first-order shading model fails, and near a highlight its direction changes within a
            window. A cut-off at 0.8 or 2 instead gives the same within 1 %.
        rounds: of reweighting, as an energy's standard error is proportional to the energy.
        fewest: least number of windows for the three unknowns.
        scatter: factor on standard errors, for windows that overlap and are shared by directions.
        common: prior standard deviation of a window's factor m - 1 on albedo's energy. At 0,
            diluted albedo is taken for relief (a weave's slopes come out three times too large).
        diluted: the same of the coefficient of m on the squared diffuse share. Dark gaps are
            diluted far more than by the share itself.
        disagreed: share of the difference of two estimates that is added to the standard deviation.
        response_around: texels, standard deviation of the blur of the sensitivity.
        together, each_band: standard deviation of the log ratio of true to predicted energy: common
            to all bands, and of each band. Half or twice as much hardly matters.
        posterior_reach, posterior_step: range and step of the log factors searched (equalise.py).
        least_energy: squared slope, lower limit of standard deviations of energies.
        even_around: texels, standard deviation of local energies. Smaller values equalise a cell
            and its groove (at 20 a leather loses 0.1 NSD and a cloth gains as much), larger ones
            leave arcs around the mirror point.
        even_directions: number of directional bands.
        even_margin: texels by which a picture is mirrored at its borders.
        even_least, even_most: limits of the local gain.
        even_sharpness: power of the sensitivity as a weight. Larger values use only places where
            the light is parallel to the direction.
        even_rounds: iterations of scaling bands to their energies, as neighbours overlap.
        strongest: largest factor on a band. At 5, leather's finest octave, which needs 11, stays
            too flat.
        least_slope: root-mean-square slope, lower limit of a band's.
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
        around: the long side over the standard deviation of the blur that the high-pass subtracts.
        drawn: logit of metal per standard deviation of goes_with_metal. Larger values follow the
            network's borders more, and the photograph less.
        texels: short side of the grid of the fit.
        rounds: iterations of fitting mean parameters and classifying texels.
        albedo, specular, roughness: prior standard deviations of the mean parameters (log, log,
            logit).
        grey, colour: scale of a texel's residual of log radiance from relief and grain, of the
            channels' mean and chroma. Smaller values classify by relief.
        patch: standard deviation of the blur of log odds, in the picture's long side. Larger values
            round borders, smaller ones classify by relief.
        counts: factor on the blurred log odds, as the residuals of neighbours are correlated.
        least_share: least share of either class.
        black, black_deviation: diffuse albedo of metal, and standard deviation of its logarithm.
        contrast: least log ratio of F0 of metal to that of the dielectric; 2.5 is typical.
        sure: least log odds that the dielectric is none but a dielectric.
        agreed: least correlation of the photograph's and the network's classification for two
            classes.
        most_off: largest residual of ring means (log radiance) over `agreed`.
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
        steps: Gauss-Newton steps. The power of granite's finest octave is 0.66, 0.74 and 0.74 of
            the photograph's after 3, 4 and 6.
        slope_step: step of slope in finite differences of log radiance.
        least_error, most_error: limits of expected errors.
        least_noise: log radiance, lower limit of the noise. Smaller values copy sensor noise into
            the maps.
        darkest: linear radiance below which logarithms are clamped.
        slow: the long side over the standard deviation of the blur whose result is left out.
        most: largest change of log radiance in a step. Gaps between threads are predicted too
            bright by more than 0.5.
        glare, glare_metal: standard deviation of the highlight's log radiance at a specular
            fraction of 1, of dielectric and metal, whose texture is its F0: a brushed steel has an
            NSD of 2.5 with 0.5, and of 1.8 with 0.15.
        chroma: ratio of the standard deviations of albedo's chroma and lightness. Larger values
            take sensor noise for colour.
        stationary: the long side over the standard deviation of the blur that is subtracted from
            albedo, as the sample is stationary.
        thinned: subsampling, texels, of least-squares sums over smooth planes.
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
class InpaintSettings:
    """Inpainting of maps under the highlight (transport.py).

    Attributes:
        tried: candidate blocks per place. More match better, and take proportionally longer.
        block: side of a block, texels: larger than the texture's features, small enough to match.
        overlap: overlap of neighbouring blocks, texels.
        trusted: least confidence of albedo in donors, over that of well seen texels. Larger values
            inpaint visible texels: at 0.93 wood loses 0.4 NSD.
        well_seen: quantile of confidence that defines well seen.
        most_hidden: largest share of the picture to inpaint, more than any flash hides.
        whole: least confident share of a donor block.
        wanted: least hidden share of a block that is replaced.
        least: hidden share of all texels below which nothing is inpainted.
        likeness: weight of the decorrelation from the photograph against the overlap's mismatch.
        stronger, shown: a place keeps its maps if its energy of log radiance is above `stronger`
            times the candidates' median and a share above `shown` is visible: a scratch, or bare
            metal that only the highlight shows.
        thinned: subsampling, texels, of rendered candidates.
        farthest: upper limit of a squared standardised difference in the overlap.
        reach: texels over which the two sides of a seam converge.
        darkest: lower limit of linear radiance and albedo before logarithms.
    """

    tried: int = 40
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
        darkest: linear radiance below which logarithms are clamped.
        most: log radiance; residuals are clipped to +-this.
        hidden: squared diffuse share at which half of the residual is assigned to albedo.
        rounds: iterations of refining albedo.
        relief_at_most: largest share of the finest bands' energy that is assigned to relief. With
            0.5, leather has an NSD of 8.1 instead of 7.4, and is sharper than the photograph.
        least_ratio, most_ratio: limits of the ratio of slope energies of successive octaves.
        thinned: subsampling, texels, of smooth planes.
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
INPAINT = InpaintSettings()
FINEST = FinestSettings()


@dataclass(frozen=True)
class BandSettings:
    """Octave bands of a plane (smooth.py); docs/notes/capture.md.

    Attributes:
        coarser: subsampling, texels, of wide blurs. Larger values are faster and leave cells.
        soft: octaves, half width of the transition between bands. Smaller values ring.
    """

    coarser: int = 8
    soft: float = 0.25


BAND = BandSettings()
