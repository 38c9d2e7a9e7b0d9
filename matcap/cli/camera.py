"""`matcap camera`: the profile of a camera, from photographs of different materials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.capture.settings import CaptureSettings
from matcap.cli.fields import NOTHING, Fields, Given, with_settings
from matcap.cli.options import QuietOption, printer
from matcap.errors import MatcapError


@with_settings
def camera(
    source: Annotated[Path, typer.Argument(metavar="FOLDER", help="A folder of photographs.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The profile.")] = Path("camera.json"),
    given: Annotated[Given, Fields(CaptureSettings, only=("fov",))] = NOTHING,
    quiet: QuietOption = False,
) -> None:
    """Estimate the vignetting of a camera and its flash.

    Needs five photographs or more of different materials by one camera, preferably matte. Give the
    file to matcap capture and matcap batch with --camera. A batch of five photographs or more
    estimates its own.
    """
    from matcap.batch.cameras import camera_of, estimated_profile
    from matcap.batch.input_folder import find_samples
    from matcap.photo.camera import write_camera_profile

    photos = [sample.photos[0] for sample in find_samples(source, group="name")]
    cameras = sorted({camera_of(photo, source) for photo in photos})
    if len(cameras) > 1:
        raise MatcapError.at(
            source,
            f"these photographs are of {len(cameras)} cameras ({'; '.join(cameras[:4])})",
            "give a folder of one camera, or run matcap batch, which separates cameras",
        )
    profile = estimated_profile(cameras[0], photos, CaptureSettings(**given))
    if profile is None:
        raise MatcapError.at(
            source,
            f"{len(photos)} photographs are too few for a camera's profile",
            "give five or more usable ones of different materials",
        )
    write_camera_profile(out, profile)
    printer(quiet=quiet)(f"wrote {out}. {profile.says()}")
