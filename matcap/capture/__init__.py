"""From a photograph to a material: coarse fit, fine-tuning, freezing, report.

The package itself can be called: `matcap.capture("photo.dng")`.
"""

from matcap.api import callable_package, capture

callable_package(__name__, capture)
