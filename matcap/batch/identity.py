"""What a material was made from, as one hash: photographs, settings, version and prior.

Two materials of the same identity are the same; whatever else has changed in the world, such a
material need not be made again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.batch.settings import BatchSettings
from matcap.errors import MatcapError
from matcap.files.maker import MAKER_VERSION
from matcap.photo.camera import CameraProfile

# Settings that say what to work on or how, and leave the material as it is; of prior and card the
# bytes count.
_NO_MATTER = ("jobs", "group", "gap", "card", "prior")
# What a setting of later versions was before there was it: unsaid, for old materials to stay.
_SINCE = {"statistics": "filterbank", "generator": "decoder", "aligned": False, "width_cm": None}


def identity(
    photos: Sequence[Path],
    settings: BatchSettings,
    *,
    prior: str,
    card: str = "",
    profile: CameraProfile | None = None,
    version: str = MAKER_VERSION,
) -> str:
    """64 hexadecimal digits.

    Args:
        photos: whose bytes count, in their order, and whose names do not.
        settings: how it is captured and written.
        prior: prior_hash of its prior.
        card: hash of the calibration that is applied, or "".
        profile: of the camera, estimated from the shoot, or None.
        version: of matcap.

    Raises:
        MatcapError: a photograph cannot be read.
    """
    chosen = {
        key: value
        for key, value in settings.named().items()
        if key not in _NO_MATTER and (key not in _SINCE or value != _SINCE[key])
    }
    for name in ("mask", "camera"):
        file = getattr(settings.capture, name)
        if file is not None:
            chosen[name] = file_hash(file)  # whose bytes count
    what: dict[str, Any] = {
        "photographs": [file_hash(photo) for photo in photos],
        "settings": chosen,
        "matcap": version,
        "prior": prior,
        "card": card,
    }
    if profile is not None:  # unsaid else, for old materials to stay
        what["camera"] = profile.document()
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def prior_hash(prior: str) -> str:
    """Of a prior as the settings name it: "auto", "none" or a file.

    Raises:
        MatcapError: a file that is no prior.
    """
    from matcap.capture.named_prior import prior_file

    file = prior_file(prior)
    return "none" if file is None else file_hash(file)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes.

    Raises:
        MatcapError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise MatcapError(
            f"the file cannot be read ({error.strerror})",
            where=str(path),
            remedy="check its name and permissions",
        ) from error
