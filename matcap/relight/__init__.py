"""Maps in a scene: camera, lights and a surface to a picture (DESIGN, section 8).

Read scene.py for what a scene is, plan.py for which effects run, render.py for the way through.
"""

from __future__ import annotations

from typing import Any

from matcap.api import callable_package


def _relight(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401
    """See matcap.relight.render.relight."""
    from matcap.relight.render import relight

    return relight(*arguments, **options)


callable_package(__name__, _relight)
