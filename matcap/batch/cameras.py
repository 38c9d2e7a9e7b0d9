"""The cameras of a shoot and their profiles: as an earlier run wrote them, or estimated.

Photographs are one camera's that name the same maker, model, lens, focal length and zoom; those
that name none, if they have as many pixels and lie in one folder. A RAW and a developed picture
are two: a tone curve changes the falloff.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from matcap.batch.memory import photo_pixels
from matcap.batch.shoot import ShotSample
from matcap.batch.work import settle_threads
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.photo.camera import LEAST, CameraProfile, read_camera_profile
from matcap.photo.exif import read_exif

FILE = "camera.json"  # in the output; of more cameras camera-2.json, ...
_MOST = 48  # photographs that are fitted: more add hardly anything
_PIXELS = 512  # across, of which the coarse fit sees blurred ones alone


def with_profiles(
    samples: Sequence[ShotSample],
    shoot: Path,
    out: Path,
    settings: CaptureSettings,
    note: Callable[[str], None] = lambda sentence: None,
    *,
    again: bool = False,
) -> tuple[list[ShotSample], Mapping[Path, CameraProfile]]:
    """Samples with the profiles of their cameras, and those by the file of each in the output.

    Where the settings give a profile, that holds for all, and nothing is estimated.

    Args:
        samples: of the shoot.
        shoot: its folder.
        out: the output, where profiles may be already; nothing is written.
        settings: of the captures.
        note: called with what is done, and with each profile estimated.
        again: estimate even what is there.

    Raises:
        MatcapError: a profile in the output is damaged.
    """
    if settings.camera is not None:
        read_camera_profile(settings.camera)  # a bad one is refused before all
        return list(samples), {}
    files = [
        file for file in (out / FILE, *sorted(out.glob("camera-[0-9]*.json"))) if file.is_file()
    ]
    read = [(file, read_camera_profile(file)) for file in files]
    known = {profile.camera: (file, profile) for file, profile in read}
    cameras = [camera_of(sample.photos[0], shoot) for sample in samples]
    profiles: dict[Path, CameraProfile] = {}
    by_camera: dict[str, CameraProfile] = {}
    for camera in sorted(set(cameras)):
        file, profile = known.get(camera, (None, None))
        if profile is None or again:
            photos = [s.photos[0] for s, own in zip(samples, cameras, strict=True) if own == camera]
            if len(photos) >= LEAST:
                note(f"Looking at the photographs of {camera} for what its corners lose.")
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


def camera_of(photo: Path, shoot: Path) -> str:
    """The name of a photograph's camera, or what else its photographs have in common."""
    try:
        said = read_exif(photo).camera
    except OSError:  # the capture reports it
        said = ""
    pixels, raw = photo_pixels(photo)
    if not said:
        folder = photo.parent.relative_to(shoot).as_posix()
        place = shoot.resolve().name if folder == "." else folder
        said = f"pictures of {pixels / 1e6:.2f} megapixels without Exif in {place}"
    return f"{said}, RAW" if raw else said


def estimated_profile(
    camera: str, photos: Sequence[Path], settings: CaptureSettings
) -> CameraProfile | None:
    """A camera's profile over its photographs, or None of too few that can be used.

    Args:
        camera: its name.
        photos: each of another material, in any order.
        settings: field of view and what is left out.
    """
    from matcap.capture.tilt import fitted
    from matcap.flash.camera_profile import camera_profile
    from matcap.photo.left_out import leave_out
    from matcap.photo.load import load_photo

    if len(photos) < LEAST:
        return None
    settle_threads()  # so that the profile does not depend on how many cores there are
    photos, fits = sorted(photos), []
    step = max(1.0, len(photos) / _MOST)
    for photo in (photos[int(number * step)] for number in range(min(len(photos), _MOST))):
        try:
            seen = load_photo(photo, long_side=_PIXELS, fov=settings.fov, noise=False)
            seen = leave_out(seen, settings.crop, settings.mask)
        except MatcapError:
            continue  # its capture will say why
        if seen.flash_fired is not False:
            fits.append(fitted(seen))
    return camera_profile(camera, fits)


def _free(out: Path, taken: set[Path]) -> Path:
    """The next file for a profile."""
    number, file = 1, out / FILE
    while file in taken or file.exists():
        number += 1
        file = out / f"camera-{number}.json"
    return file
