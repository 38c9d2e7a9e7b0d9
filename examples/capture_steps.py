"""A capture step by step: every step is a public function, and any can be replaced.

python examples/capture_steps.py PHOTO OUT [--flat-prior]

`--flat-prior` replaces the inverse network by a prior of flat, even maps: what the photograph alone
then says of relief and albedo is the measurement's.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matcap
from matcap.brdf.folder import MapSetInfo
from matcap.capture.exemplar.detail_transfer import transfer_detail
from matcap.capture.exemplar.estimate import (
    classified,
    indexed,
    measured_spectrum,
    scaled_to_spectrum,
)
from matcap.capture.exemplar.glints import without_glints
from matcap.capture.exemplar.inpaint import inpainted
from matcap.capture.exemplar.mean_parameters import most_probable_scale, scaled
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.exemplar.predict import NetworkPrediction, exemplar_of, map_set_of, predict_maps
from matcap.capture.exemplar.refine import refine_maps, refitted_to_highlight
from matcap.capture.rectified import Observation, Rectified, fit_photograph
from matcap.field.material import Material
from matcap.flash.highlight import limit_sparkles
from matcap.photo.photo import Photo

Prior = Callable[[Observation], tuple[Observation, NetworkPrediction]]


def network_prior(observed: Observation) -> tuple[Observation, NetworkPrediction]:
    """The shipped inverse network."""
    return predict_maps(observed, load_inverse())


def flat_prior(observed: Observation) -> tuple[Observation, NetworkPrediction]:
    """Flat, even maps: residuals of zero from the coarse fit, with the network's deviations."""
    observed, predicted = predict_maps(observed, load_inverse())
    return observed, replace(
        predicted, residuals=predicted.residuals - predicted.residuals, logit=None
    )


def capture(photo: Photo, prior: Prior = network_prior) -> tuple[Material, matcap.MapSet]:
    """A photograph to a material, and to the maps of the photographed rectangle."""
    photo = limit_sparkles(photo)  # lone glints above white are lower bounds
    coarse = fit_photograph(photo)  # camera, flash, tone curve and a uniform material
    rectified = Rectified.of(photo.linearised(coarse.tone), coarse, max(photo.pixels.shape))

    observed, predicted = prior(Observation.of(rectified.network_input, coarse))
    spectrum = measured_spectrum(observed)
    predicted = scaled_to_spectrum(observed, predicted, spectrum)
    observed, predicted = classified(observed, predicted)  # dielectric, metal, or both
    finest = rectified.network_input.size == rectified.whole.size  # they will not be enlarged
    predicted = refine_maps(observed, predicted, spectrum, finest=finest)  # they re-render to it

    exemplar, copies = inpainted(exemplar_of(observed, predicted), observed)  # under the highlight
    exemplar = refitted_to_highlight(exemplar, observed, predicted.metal)
    metal = bool(predicted.metal.any())  # glints of a dielectric are no albedo
    matte = without_glints(rectified.whole, coarse, metal=metal)
    exemplar = transfer_detail(exemplar, matte, coarse, copies)
    scale = most_probable_scale(exemplar, predicted.metal)  # what one flash leaves open
    exemplar = scaled(exemplar, scale).rounded()
    whole = rectified.whole  # fields show nothing from outside of the photograph's frame
    kept = None if whole.left_out is None else whole.kept.numpy()
    exemplar, example = indexed(exemplar, rectified.waves, turned=photo.turned, kept=kept)
    material = Material(
        name=photo.stem,
        generators={"example": example},
        texel_size=rectified.whole.texel_size,
        setup=replace(coarse.setup.dimmed(scale), turned=photo.turned),
    )
    return material, map_set_of(exemplar)


if __name__ == "__main__":
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    photo = matcap.load_photo(path, long_side=1024)
    material, maps = capture(photo, flat_prior if "--flat-prior" in sys.argv else network_prior)
    matcap.write_mapset(maps, out, MapSetInfo(material.name, seed=0))
    material.save(out / f"{material.name}.matcap")
