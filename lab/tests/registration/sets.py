"""Simulated sets of hand-held photographs, easy and hard, and errors of their cameras."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import cv2
import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.multiview.align import Aligned, aligned
from matcap.capture.multiview.estimate import fitted_first, predict_alone
from matcap.capture.registration.camera import Doubles, PosedCamera
from matcap.capture.registration.register import Registration, register, register_in_any_order
from matcap.capture.settings import MULTIVIEW_STAGES, CaptureClock
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import fit_coarse
from matcap.photo.checks import CHECKS
from matcap.photo.photo import Photo
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.hand_held import Hand, hold, take_several
from matcap_lab.simulate.named import MATERIALS
from matcap_lab.simulate.photograph import PhoneCamera, Realise, as_photo
from matcap_lab.simulate.specimen import EXAMPLES

EASY = ("leather", "granite", "rust", "plaster")
# What a set is made hard by; one of each in turn.
HARD = ("weave", "plain", "blurred", "foreign", "exposed", "apart", "steep")

(UNCERTAIN,) = CHECKS["cameras"].limits
_WRONG = 0.02  # of the distance: nobody would call that camera right

Verdict = Literal["right", "near", "refused", "wrong"]


@dataclass(frozen=True)
class MadeSet:
    """Photographs of a sample, true cameras, and indices of photographs of another sample."""

    photos: tuple[Photo, ...]
    cameras: tuple[PosedCamera, ...]
    foreign: frozenset[int] = frozenset()


@dataclass(frozen=True)
class SetOutcome:
    """Errors of the registration of a set."""

    errors: tuple[float, ...]
    """Error of each used photograph's camera but the first's, over its distance."""
    kept_out: tuple[str, ...]
    """Photographs of the sample that were left out, with the reason."""
    taken_in: int
    """Number of photographs of other samples that were used."""
    tilt: float
    """Error of the first camera's tilt, degrees."""
    deviations: tuple[float, ...] = ()
    """Standard deviation that was stated for each of `errors`."""


def make_set(number: int, *, hard: str | None, width: int = 800) -> MadeSet:
    """A set of three to five photographs by a seed; `hard` is one of HARD or None."""
    rng = np.random.default_rng(number)
    phone = PhoneCamera(width=width, height=width * 3 // 4, supersampling=1)
    hand = Hand(
        aside=float(rng.uniform(0.2, 0.4)),
        shaken=float(rng.uniform(0.01, 0.05)),
        bent=(float(rng.normal(0.0, 0.01)), 0.0),
        vignetting=float(rng.uniform(0.0, 0.4)),
    )
    material = EASY[int(rng.integers(len(EASY)))]
    if hard == "weave":
        material = "cloth"
    elif hard is None and rng.random() < 0.2:
        material = sorted(MATERIALS)[int(rng.integers(len(MATERIALS)))]
    realise = _plain(number) if hard == "plain" else EXAMPLES[material].pieces(number)
    if hard == "apart":
        hand = replace(hand, aside=0.75)
    elif hard == "steep":
        hand = replace(hand, aside=float(rng.uniform(0.6, 1.2)))
    cameras = hold(phone, hand, int(rng.integers(3, 6)), number)
    if hard == "apart":
        # Straight down from their places: about a third of the first's view is seen.
        cameras = [cameras[0], *(replace(camera, turn=np.eye(3)) for camera in cameras[1:])]
    shots = take_several(realise, phone, cameras, hand, number)
    photos = [as_photo(one, number + n, f"p{n}") for n, one in enumerate(shots)]
    foreign = frozenset[int]()
    if hard == "foreign":
        other = EASY[(EASY.index(material) + 1) % 4] if number % 2 else material
        piece = EXAMPLES[other].pieces(99991)
        stranger = take_several(piece, phone, cameras[1:2], hand, number)[0]
        photos[-1] = as_photo(stranger, number, "foreign")
        foreign = frozenset({len(photos) - 1})
    elif hard == "blurred":  # by a hand that moves sideways
        kernel = np.ones((1, max(3, round(width / 100.0) | 1)), np.float32)
        smeared = cv2.filter2D(photos[-1].pixels, -1, kernel / kernel.size)
        photos[-1] = replace(photos[-1], pixels=smeared)
    elif hard == "exposed":
        photos = [photos[0], *(_otherwise(photo, rng) for photo in photos[1:])]
        around = np.diag([-1.0, -1.0, 1.0])
        cameras = [cameras[0], *(replace(c, turn=around @ c.turn) for c in cameras[1:])]
    return MadeSet(tuple(photos), tuple(cameras), foreign)


def outcome_of(made: MadeSet, detail: int | None = None) -> SetOutcome:
    """Errors of a set registered by features, or also by rendering on `detail` texels across."""
    try:
        if detail is None:
            return compared(made, register(made.photos, fit_coarse(made.photos[0]).setup))
        network, clock = load_inverse(), CaptureClock(None, MULTIVIEW_STAGES)
        found, coarse, plane = fitted_first(register_in_any_order(made.photos), detail, clock)
        read, _, _ = predict_alone(plane, coarse, network, clock)
        placed = aligned(Aligned.of(found.views, coarse.setup), read)
        return compared(made, replace(found, views=placed.views))
    except MatcapError as error:
        return SetOutcome((), (str(error),), 0, math.nan)


def relative_position(first: PosedCamera, camera: PosedCamera) -> Doubles:
    """(3,) position of a camera in the first one's frame."""
    return first.turn @ (camera.place - first.place)


def compared(made: MadeSet, found: Registration) -> SetOutcome:
    """Errors of cameras in the first one's frame, and of the first one's tilt."""
    names = [photo.name for photo in made.photos]
    first, true_first = found.views[0].camera, made.cameras[0]
    errors, deviations, taken_in = [], [], 0
    for view in found.views[1:]:
        number = names.index(view.photo.name)
        if number in made.foreign:
            taken_in += 1
            continue
        true = made.cameras[number]
        off = relative_position(first, view.camera) - relative_position(true_first, true)
        errors.append(float(np.linalg.norm(off) / np.linalg.norm(true.place)))
        deviations.append(view.position_deviation)
    wrong = [one for one in found.left_out if names.index(one.name) not in made.foreign]
    turned = first.turn[2] @ true_first.turn[2]
    return SetOutcome(
        tuple(errors),
        tuple(f"{one.name}: {one.why}" for one in wrong),
        taken_in,
        math.degrees(math.acos(min(1.0, float(turned)))),
        tuple(deviations),
    )


def verdict(outcome: SetOutcome) -> Verdict:
    """Verdict by the worst camera; refused if there is none, with the reason."""
    worst = max(outcome.errors, default=0.0)
    if outcome.taken_in or worst > _WRONG:
        return "wrong"
    if not outcome.errors:
        return "refused" if outcome.kept_out else "wrong"
    return "right" if worst <= UNCERTAIN else "near"


def unsaid(outcome: SetOutcome) -> bool:
    """Whether an error exceeds UNCERTAIN while no stated deviation does."""
    return max(outcome.errors, default=0.0) > UNCERTAIN >= max(outcome.deviations, default=0.0)


def kinds(sets: int) -> list[str | None]:
    """What each of `sets` sets is made hard by: every third by HARD in turn, others by None."""
    return [HARD[(n // 3) % len(HARD)] if n % 3 == 2 else None for n in range(sets)]


def columns(_made: MadeSet, outcome: SetOutcome) -> Mapping[str, Value]:
    """Row of a table about a set: verdicts are 0 or 1, tilt is in degrees."""
    errors, of = outcome.errors or (math.nan,), verdict(outcome)
    return {
        "cameras": float(len(outcome.errors)),
        "median": float(np.median(errors)),
        "worst": max(errors),
        "said": max(outcome.deviations, default=math.nan),
        "tilt": outcome.tilt,
        **{name: float(of == name) for name in get_args(Verdict)},
        "unsaid": float(unsaid(outcome)),
        "taken in": float(outcome.taken_in),
        "left out": float(len(outcome.kept_out)),
        "why": "; ".join(outcome.kept_out),
    }


def sets_experiment(count: int, seed: int, detail: int | None) -> Experiment[MadeSet, SetOutcome]:
    """Registration of `count` sets, every third hard; each difficulty is a configuration.

    Args:
        count: number of sets.
        seed: of the first.
        detail: as of outcome_of.
    """
    kind_of = {f"{number}": kind for number, kind in enumerate(kinds(count), seed)}

    return Experiment(
        "registration",
        {name: partial(make_set, int(name), hard=kind) for name, kind in kind_of.items()},
        {
            kind or "easy": Configuration(lambda made, _seed: outcome_of(made, detail))
            for kind in kind_of.values()
        },
        (columns,),
        skips=lambda name, kind: kind != (kind_of[name] or "easy"),
        settings=detail,
        any_version=True,
    )


def _plain(seed: int) -> Realise:
    """Plastic with nothing on it but the faintest grain."""

    def piece(width: int, height: int, texel_size: float) -> MapSet:
        grain = torch.randn(1, height, width, generator=torch.Generator().manual_seed(seed))
        return MapSet(
            diffuse=torch.full((3, height, width), 0.2),
            specular=torch.full((1, height, width), 0.04),
            roughness=torch.full((1, height, width), 0.35),
            height=2e-3 * texel_size * grain,
            texel_size=texel_size,
        )

    return piece


def _otherwise(photo: Photo, rng: np.random.Generator) -> Photo:
    """Two stops darker or one lighter, another white balance, and upside down."""
    stops, balance = rng.uniform(-2.0, 1.0), np.exp(rng.normal(0.0, 0.25, 3))
    pixels = (photo.pixels * 2.0**stops * balance).clip(0.0, 1.0).astype(np.float32)
    pixels = np.ascontiguousarray(pixels[::-1, ::-1])
    return replace(photo, pixels=pixels, clipped=(pixels >= 1.0).any(-1))
