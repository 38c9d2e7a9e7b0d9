"""Hash of all inputs of a material: photographs, settings, version, prior, calibration.

Equal hashes mean equal materials: one that exists need not be made again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matcap.batch.settings import BatchSettings
from matcap.capture.settings import prior_file
from matcap.errors import MatcapError
from matcap.files.maker import MAKER_VERSION

# Settings that do not change a material; of prior and card the content is hashed instead.
_NO_MATTER = ("jobs", "group", "gap", "card", "prior")


def identity(
    photos: Sequence[Path],
    settings: BatchSettings,
    *,
    prior: str,
    card: str = "",
) -> str:
    """SHA-256 of a material's inputs, 64 hexadecimal digits.

    Args:
        photos: in order; their content counts, their names do not.
        prior: prior_hash of the prior.
        card: hash of the calibration, or "".

    Raises:
        MatcapError: a photograph cannot be read.
    """
    chosen = {key: value for key, value in settings.named().items() if key not in _NO_MATTER}
    if settings.capture.mask is not None:
        chosen["mask"] = file_hash(settings.capture.mask)
    what: dict[str, Any] = {
        "photographs": [file_hash(photo) for photo in photos],
        "settings": chosen,
        "matcap": MAKER_VERSION,
        "prior": prior,
        "card": card,
    }
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def prior_hash(prior: str) -> str:
    """Hash of a prior named "auto", "none" or by a file.

    Raises:
        MatcapError: the file is no prior.
    """
    file = prior_file(prior)
    return prior if file is None else file_hash(file)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content.

    Raises:
        MatcapError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise MatcapError.at(
            path, f"the file cannot be read ({error.strerror})", "check its name and permissions"
        ) from error
