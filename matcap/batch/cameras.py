"""Profiles of the cameras of an input folder: read from the output, or estimated.

Photographs belong to one camera if their Exif has the same maker, model, lens, focal length and
zoom; without Exif, if they have the same number of pixels and are in the same folder. RAW and
developed pictures are different cameras: a tone curve changes the falloff.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from matcap.batch.input_folder import ShotSample
from matcap.batch.memory import photo_pixels
from matcap.batch.work import settle_threads
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.photo.camera import LEAST, CameraProfile, read_camera_profile
from matcap.photo.exif import read_exif

FILE = "camera.json"  # in the output; of further cameras camera-2.json, ...
_MOST = 48  # most photographs in a fit: more hardly change it
_PIXELS = 512  # long side to which photographs are reduced: the coarse fit blurs them anyway


def with_profiles(
    samples: Sequence[ShotSample],
    source: Path,
    out: Path,
    settings: CaptureSettings,
    note: Callable[[str], None] = lambda sentence: None,
    *,
    again: bool = False,
) -> tuple[list[ShotSample], Mapping[Path, CameraProfile]]:
    """Add to each sample the profile of its camera; returns also the profiles by their files.

    A profile in the settings is used for all samples, and none is estimated.

    Args:
        out: the output folder, which may have profiles of an earlier run; nothing is written.
        note: called with a sentence for each estimation and each profile.
        again: estimate profiles that the output already has.

    Raises:
        MatcapError: a profile in the output is damaged.
    """
    if settings.camera is not None:
        read_camera_profile(settings.camera)  # refuse a damaged file before any work
        return list(samples), {}
    files = [
        file for file in (out / FILE, *sorted(out.glob("camera-[0-9]*.json"))) if file.is_file()
    ]
    read = [(file, read_camera_profile(file)) for file in files]
    known = {profile.camera: (file, profile) for file, profile in read}
    cameras = [camera_of(sample.photos[0], source) for sample in samples]
    profiles: dict[Path, CameraProfile] = {}
    by_camera: dict[str, CameraProfile] = {}
    for camera in sorted(set(cameras)):
        file, profile = known.get(camera, (None, None))
        if profile is None or again:
            photos = [s.photos[0] for s, own in zip(samples, cameras, strict=True) if own == camera]
            if len(photos) >= LEAST:
                note(f"Estimating the light falloff of {camera} from {len(photos)} photographs.")
            profile = estimated_profile(camera, photos, settings) or profile
        if profile is not None:
            by_camera[camera] = profile
            profiles[file or _free(out, {*files, *profiles})] = profile
            note(profile.says())
    profiled = [
        replace(sample, profile=by_camera.get(camera))
        for sample, camera in zip(samples, cameras, strict=True)
    ]
    return profiled, profiles


def camera_of(photo: Path, source: Path) -> str:
    """Name of a photograph's camera; without Exif, a description by size and folder."""
    try:
        said = read_exif(photo).camera
    except OSError:  # the capture reports it
        said = ""
    pixels, raw = photo_pixels(photo)
    if not said:
        folder = photo.parent.relative_to(source).as_posix()
        place = source.resolve().name if folder == "." else folder
        said = f"pictures of {pixels / 1e6:.2f} megapixels without Exif in {place}"
    return f"{said}, RAW" if raw else said


def estimated_profile(
    camera: str, photos: Sequence[Path], settings: CaptureSettings
) -> CameraProfile | None:
    """Estimate a camera's profile; None if too few photographs are usable.

    Args:
        photos: each of another material, in any order.
        settings: field of view, crop and mask.
    """
    from matcap.capture.camera_profile import camera_profile
    from matcap.capture.tilt import fit_photograph
    from matcap.photo.left_out import leave_out
    from matcap.photo.load import load_photo

    if len(photos) < LEAST:
        return None
    settle_threads()  # results must not depend on the number of cores
    photos, fits = sorted(photos), []
    step = max(1.0, len(photos) / _MOST)
    for photo in (photos[int(number * step)] for number in range(min(len(photos), _MOST))):
        try:
            seen = load_photo(photo, long_side=_PIXELS, fov=settings.fov, noise=False)
            seen = leave_out(seen, settings.crop, settings.mask)
        except MatcapError:
            continue  # its capture reports the error
        if seen.flash_fired is not False:
            fits.append(fit_photograph(seen))
    return camera_profile(camera, fits)


def _free(out: Path, taken: set[Path]) -> Path:
    """The first unused file name for a profile."""
    number, file = 1, out / FILE
    while file in taken or file.exists():
        number += 1
        file = out / f"camera-{number}.json"
    return file
