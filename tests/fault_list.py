"""Deliberate faults over all packages, and the tests that must catch each. faults.py tries them."""

from __future__ import annotations

from dataclasses import dataclass

_BOUNDS = "tests/relight/test_relight_bounds.py"
_EDGES = "tests/relight/test_relight_edges.py"
_TILES = "tests/relight/test_relight_tiles.py"
_LOOPS = "tests/relight/test_relight_loops.py"
_PUBLISHING = "tests/files/test_publishing.py"


@dataclass(frozen=True)
class Fault:
    """One.

    Attributes:
        name: what is wrong.
        file: below the package's folder.
        right, wrong: text, and what it is replaced by.
        tests: that should fail, as pytest names them; the last may be -k with an expression.
    """

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


def bounds(effect: str) -> tuple[str, ...]:
    """The tests of an effect's bound."""
    return _BOUNDS, "-k", f"{effect} or adds_up"


def effect_fault(effect: str, name: str, right: str, wrong: str, file: str = "") -> Fault:
    """A fault in a bound."""
    file = f"relight/{file or f'effects/{effect}.py'}"
    return Fault(f"{effect} bound: {name}", file, right, wrong, bounds(effect))


RELIGHTING_AND_FILES = (
    effect_fault("specular", "glossy a hundredth", "/ (2.0 * math.pi *", "/ (200.0 * math.pi *",
                 "facts.py"),
    effect_fault("specular", "alpha squared for cubed", "self.alpha[0] ** 3", "self.alpha[0] ** 2",
                 "facts.py"),
    effect_fault("specular", "Fresnel's F0 alone", "return self.specular + (1.0 - self.specular)",
                 "return self.specular + 0.0 * (1.0 - self.specular)", "facts.py"),
    effect_fault("specular", "surroundings forgotten", "direct + facts.sky * WHOLE",
                 "direct", "effects/direct.py"),
    effect_fault("diffuse", "surroundings forgotten", "+ facts.diffuse * facts.sky", "",
                 "effects/direct.py"),
    effect_fault("diffuse", "half", "facts.lambert * light +", "0.5 * facts.lambert * light +",
                 "effects/direct.py"),
    effect_fault("falloff", "a tenth", "light.varying * (facts.lambert",
                 "0.1 * light.varying * (facts.lambert", "effects/direct.py"),
    effect_fault("falloff", "nearer lights forgotten", "max(received - intensity / central**2",
                 "max(0.0 * received - intensity / central**2", "facts.py"),
    effect_fault("area", "a hundredth", "return Bound(total,", "return Bound(0.01 * total,"),
    effect_fault("area", "no light has a size", "if light.half_angle > 0.0", "if False"),
    effect_fault("environment", "a tenth", "facts.sky_varying * both +",
                 "0.1 * facts.sky_varying * both +"),
    effect_fault("environment", "tilt forgotten", "tilt = 1.0 if", "tilt = 0.0 if"),
    effect_fault("filtering", "a tenth", "Bound(facts.everything", "Bound(0.1 * facts.everything"),
    effect_fault("parallax", "a tenth", "Bound(facts.everything", "Bound(0.1 * facts.everything"),
    effect_fault("shadows", "only the lowest light's tenth", "Bound(sum(", "Bound(0.1 * sum("),
    effect_fault("shadows", "no light is low", "light.tangent < slope", "light.tangent < 0.0"),
    effect_fault("visibility", "nothing", "Bound(facts.surroundings",
                 "Bound(0 * facts.surroundings"),
    effect_fault("interreflection", "a twentieth", "Bound(facts.lambert**2",
                 "Bound(0.05 * facts.lambert**2"),
    effect_fault("multiscatter", "lights forgotten", "lobe / math.pi * light", "0.0 * light"),
    effect_fault("multiscatter", "surroundings forgotten", "share * facts.sky", "0.0 * facts.sky"),
    Fault("plan: bounds do not add up", "relight/plan.py",
          "            left -= bounds[effect].radiance\n", "", (_BOUNDS, "-k", "adds_up")),
    Fault("plan: largest first", "relight/plan.py", "key=lambda name: bounds[name].radiance",
          "key=lambda name: -bounds[name].radiance", (_BOUNDS, "-k", "adds_up")),
    Fault("tiles: budgets as at white", "relight/budget.py", "found: Array = allowed / srgb_slope(",
          "found: Array = 30.0 * allowed / srgb_slope(", (_TILES, "-k", "budget")),
    Fault("loops: walks end early", "relight/horizons.py", "[one.max() for one in np.split",
          "[0.1 * one.max() for one in np.split", (_LOOPS, "-k", "horizons_are_those")),
    Fault("loops: horizons of the texel beside", "relight/loops/horizons.c",
          "+ column + w->reach;", "+ column + w->reach + 1;", (_LOOPS, "-k", "horizons_are_those")),
    Fault("loops: low directions are clear", "relight/loops/surroundings.c",
          "float limit = sine + b->v[2]", "float limit = 0.5f * sine + b->v[2]",
          (_LOOPS, "-k", "mirrored")),
    Fault("loops: lights that set by rules of few points", "relight/loops/area.c",
          "if (*sets || plain >= SAMPLED)", "if (plain >= SAMPLED)", (_TILES, "-k", "sets_behind")),
    Fault("photographs: no vignetting", "relight/render.py", "if view.vignetted:", "if False:",
          ("tests/relight/test_relight_photographed.py", "-k", "straight_above")),
    Fault("photographs: a camera that is never rolled", "relight/photographed.py",
          "        up=up,\n", "",
          ("tests/relight/test_relight_photographed.py", "-k", "tilted")),
    Fault("tiles: parts of a light weigh differently", "relight/effects/area.py",
          "pieces = 1 if not parts else", "pieces = 1 if parts else", (_TILES, "-k", "weigh")),
    Fault("publishing: files are not synced", "files/publish.py", "os.fsync(handle)", "pass",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: no order", "files/publish.py", "(name.endswith(\".json\"), name)",
          "(not name.endswith(\".json\"), name)", (_PUBLISHING, "-k", "last")),
    Fault("publishing: no roll-back", "files/publish.py",
          "    except BaseException:\n        _mend(folder)\n        raise",
          "    except BaseException:\n        raise",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: folders are not refused", "files/publish.py", "if path.is_dir() and",
          "if False and", (_PUBLISHING, "-k", "refused")),
    Fault("publishing: what is replaced stays", "files/publish.py",
          "for name in set(old) - set(fresh):", "for name in ():",
          ("tests/files/test_staging.py", "-k", "replaced_files")),
    Fault("publishing: the list goes first", "files/publish.py",
          "        for name in fresh:\n            os.replace(stage / name, folder / name)",
          "        os.unlink(folder / JOURNAL / _LIST)\n        for name in fresh:\n"
          "            os.replace(stage / name, folder / name)",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: the folder is not synced before the list goes", "files/publish.py",
          "        sync(folder)\n        os.unlink(folder / JOURNAL / _LIST)",
          "        os.unlink(folder / JOURNAL / _LIST)",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: nobody reads the journal", "files/publish.py",
          "if os.path.lexists(folder / JOURNAL):", "if False:", (_PUBLISHING, "-k", "whoever")),
    Fault("environment: a plane sees behind itself", "relight/render.py",
          "sky.above_plane() if flat else sky", "sky", (_EDGES, "-k", "behind")),
    Fault("lights of any brightness", "relight/render.py",
          "        check_lights(scene.lights)\n", "", (_EDGES, "-k", "too_bright_is_named")),
    Fault("overflow is not told", "relight/render.py",
          "if not all(np.isfinite(row).all() for row in picture):",
          "if False:", (_EDGES, "-k", "overflows")),
    Fault("heights of any size are written", "brdf/folder.py",
          '    check_heights(arrays["height"], "height")\n', "", (_EDGES, "-k", "no_surface")),
    Fault("rays for ever", "relight/render.py",
          "        _check_relief(self.texture, surface)\n", "", (_EDGES, "-k", "no_ray")),
    Fault("lines are triangles", "relight/surfaces/mesh.py", "(area > _SMALLEST * size**2).any()",
          "True", (_EDGES, "-k", "no_area")),
    Fault("half floats overflow", "files/exr.py", "> LARGEST_HALF", "> np.inf",
          (_EDGES, "-k", "half_float")),
)  # fmt: skip


def exemplar(module: str) -> str:
    """A test module of the exemplar's."""
    return f"tests/capture/piece/test_{module}.py"


def swept(domain: str) -> tuple[str, ...]:
    """The short form of the sweep of relighting, one domain of it."""
    return "tests/lab/stability/test_stable_relighting.py", "-k", f"nothing and {domain}"


_RENDER, _PLANE = ("tests/flash/test_flash_render.py",), ("tests/flash/test_flash_plane.py",)
_FREEZE = ("tests/space/tuning/test_final_freeze.py",)
_FROZEN = "moments = freeze(decoder, code, scene.waves)"
_WRONGLY = "moments = freeze(decoder, 0.0 * code, scene.waves)"
_INDEX = ("tests/example/test_example_field.py",)
_MASK = ("tests/synth/test_mask.py",)
_SHOOT = ("tests/batch/test_shoot.py",)
_FIND = (exemplar("find"), "-k", "hole or holes or units")

CAPTURE = (
    Fault(
        "vignetting: its sign",
        "flash/light.py",
        "return -squared * (",
        "return squared * (",
        _RENDER,
    ),
    Fault(
        "vignetting: linear in the radius",
        "flash/light.py",
        "squared = image.square().sum(0)",
        "squared = image.square().sum(0).sqrt()",
        _RENDER,
    ),
    Fault(
        "flash: falls off with distance alone",
        "flash/light.py",
        "intensity / squared_distance",
        "intensity / squared_distance.sqrt()",
        _RENDER,
    ),
    Fault(
        "first encoding: the clip mask is not looked at",
        "flash/plane.py",
        "fit_encoding(linear, valid, noise)",
        "fit_encoding(linear, valid | ~valid, noise)",
        _PLANE,
    ),
    Fault(
        "first encoding: middle grey of burnt texels",
        "statistics/encoding.py",
        "seen = linear[:, valid]",
        "seen = linear.flatten(1)",
        _PLANE,
    ),
    Fault(
        "first encoding: colours of burnt texels",
        "statistics/encoding.py",
        "(log - shading(log))[0][:, valid]",
        "(log - shading(log))[0].flatten(1)",
        _PLANE,
    ),
    Fault(
        "final freeze: at the wrong code",
        "space/tuning/finetune.py",
        f"    if moments is None or not history:\n        {_FROZEN}",
        f"    if moments is None or not history:\n        {_WRONGLY}",
        _FREEZE,
    ),
    Fault(
        "frozen end: at the wrong code",
        "space/tuning/finetune.py",
        f"schedule.freezes:\n                {_FROZEN}",
        f"schedule.freezes:\n                {_WRONGLY}",
        _FREEZE,
    ),
    Fault(
        "no steps: frozen at the wrong code",
        "space/tuning/finetune.py",
        "tuple(freeze(decoder, code,",
        "tuple(freeze(decoder, 0.0 * code,",
        _FREEZE,
    ),
    Fault(
        "coarse fit: what is clipped is as it looks",
        "flash/coarse.py",
        "above = np.where(clipped, 0.0,",
        "above = np.where(clipped, 1.0,",
        ("tests/flash/test_coarse.py", "-k", "plateau"),
    ),
    Fault(
        "coarse fit: a known tilt is not held",
        "flash/coarse.py",
        "tilt=_numbers(1e-4, 1e-4)",
        "tilt=_numbers(1.0, 1.0)",
        ("tests/flash/test_coarse.py", "-k", "held"),
    ),
    Fault(
        "refine: clipped texels say nothing",
        "capture/piece/refine.py",
        "observed - log\n    return torch.where(valid, residual, residual.clamp_min(0.0))",
        "observed - log\n    return torch.where(valid, residual, 0.0 * residual)",
        (exemplar("refine"), "-k", "clipped"),
    ),
    Fault(
        "refine: clipped texels are as they look",
        "capture/piece/refine.py",
        "observed - log\n    return torch.where(valid, residual, residual.clamp_min(0.0))",
        "observed - log\n    return residual",
        (exemplar("refine"), "-k", "clipped"),
    ),
    Fault(
        "levels: clipped cells say nothing",
        "capture/piece/refine.py",
        "torch.where(seen, residual, residual.clamp_min(0.0))\n        # What",
        "torch.where(seen, residual, 0.0 * residual)\n        # What",
        (exemplar("refine"), "-k", "clipped"),
    ),
    Fault(
        "levels: clipped cells are as they look",
        "capture/piece/refine.py",
        "        residual = torch.where(seen, residual, residual.clamp_min(0.0))\n",
        "",
        (exemplar("refine"), "-k", "clipped"),
    ),
    Fault(
        "flatten: means of what is not trusted",
        "capture/piece/refine.py",
        "confidence[name].square() + 1e-3",
        "torch.ones_like(confidence[name])",
        (exemplar("refine"), "-k", "trusted"),
    ),
    Fault(
        "flatten: by another map's trust",
        "capture/piece/refine.py",
        "confidence[name]",
        "confidence['diffuse']",
        (exemplar("refine"), "-k", "trusted"),
    ),
    Fault(
        "flatten: what follows the highlight stays",
        "capture/piece/refine.py",
        "channel - torch.from_numpy(_following(",
        "channel - 0.0 * torch.from_numpy(_following(",
        (exemplar("refine"), "-k", "stationary"),
    ),
    Fault(
        "flatten: what drifts stays",
        "capture/piece/refine.py",
        "channel + (mean - torch.from_numpy(slow))",
        "channel + 0.0 * mean",
        (exemplar("refine"), "-k", "stationary or trusted"),
    ),
    Fault(
        "equalise: mirrored directions",
        "capture/piece/equalise.py",
        "-np.fft.fftfreq(shape[0])",
        "np.fft.fftfreq(shape[0])",
        (exemplar("equalise"), "-k", "shown_best"),
    ),
    Fault(
        "equalise: as strong as on the mean",
        "capture/piece/equalise.py",
        "** STRENGTH.even_sharpness + 1e-9",
        "** 0.0",
        (exemplar("equalise"), "-k", "shown_best"),
    ),
    Fault(
        "equalise: whatever the photograph says",
        "capture/piece/equalise.py",
        "if strengths is None:",
        "if True:",
        (exemplar("equalise"), "-k", "sure"),
    ),
    Fault(
        "equalise: however little it is trusted",
        "capture/piece/believed.py",
        "doubt[:, None] + STRENGTH.least_energy",
        "STRENGTH.least_energy",
        (exemplar("equalise"), "-k", "sure"),
    ),
    Fault(
        "equalise: weaker for stronger",
        "capture/piece/equalise.py",
        "np.sqrt(wanted / drawn)",
        "np.sqrt(drawn / wanted)",
        (exemplar("equalise"), "-k", "sure"),
    ),
    Fault(
        "equalise: a bowl is relief",
        "capture/piece/equalise.py",
        "bands = split(height)[:-1]",
        "bands = [height, *split(height)[1:-1]]",
        (exemplar("equalise"), "-k", "bowl"),
    ),
    Fault(
        "integrate: y downwards",
        "capture/piece/integrate.py",
        "divergence[:-1] += down",
        "divergence[:-1] -= down",
        (exemplar("integrate"),),
    ),
    Fault(
        "adapt: albedo's levels stand still",
        "capture/piece/adapt.py",
        "self._means + offsets[:, None, None] + gain",
        "self._means + gain",
        (exemplar("adapt"), "-k", "come_back"),
    ),
    Fault(
        "confidence: clipped texels' neighbours",
        "capture/piece/find.py",
        "np.minimum(share, np.clip(2.0 * around - 1.0, 0.0, 1.0))",
        "share",
        _FIND,
    ),
    Fault(
        "confidence: one map's units for another's",
        "capture/piece/find.py",
        "np.array(units, np.float32)",
        "np.array(units[::-1], np.float32)",
        _FIND,
    ),
    Fault(
        "ties: colour tells nothing of gloss",
        "capture/piece/ties.py",
        "by_colour * self.colour",
        "1e-3 * by_colour * self.colour",
        (exemplar("adapt"), "-k", "colour"),
    ),
    Fault(
        "highlight: the first bright patch",
        "flash/highlight.py",
        "if found is None or _others(blurred, found) < HIGHLIGHT.others:",
        "if found is None or _others(blurred, found) < 1e3:",
        ("tests/flash/test_coarse_highlight.py", "-k", "patches"),
    ),
    Fault(
        "transport: everything but the hole",
        "capture/piece/transport.py",
        "drawn.stacked + share * (laid - drawn.laid)",
        "laid + share * (drawn.stacked - laid)",
        (exemplar("transport"),),
    ),
    Fault(
        "transport: whatever does not look like it",
        "capture/piece/transport.py",
        "unlike = 1.0 - (a * b)",
        "unlike = 1.0 + (a * b)",
        (exemplar("transport"),),
    ),
    Fault(
        "contrast: fainter for stronger",
        "capture/piece/contrast.py",
        "wanted / np.maximum(here, ADAPT.contrast_faintest)",
        "np.maximum(here, ADAPT.contrast_faintest) / wanted",
        (exemplar("contrast"),),
    ),
    Fault(
        "strengths: no covariance of albedo and slope",
        "capture/piece/strengths.py",
        "2.0 * slant, squared",
        "0.0 * slant, squared",
        (exemplar("strengths"), "-k", "goes_with"),
    ),
    Fault(
        "strengths: albedo shows alike everywhere",
        "capture/piece/strengths.py",
        "[STRENGTH.common * np.eye(windows), drift]",
        "[0.0 * np.eye(windows), 0.0 * drift]",
        (exemplar("strengths"), "-k", "dilutes"),
    ),
    Fault(
        "strengths: noise is added, not taken off",
        "capture/piece/strengths.py",
        "np.maximum(energy - white, 0.0)",
        "np.maximum(energy + white, 0.0)",
        (exemplar("strengths"), "-k", "noise"),
    ),
    Fault(
        "strengths: y downwards",
        "capture/piece/strengths.py",
        "np.meshgrid(frequency, -frequency)",
        "np.meshgrid(frequency, frequency)",
        (exemplar("strengths"), "-k", "slopes_are"),
    ),
)

FIELD = (
    Fault(
        "index: doubt is no reason",
        "example/index.py",
        "np.maximum(_doubt(exemplar)",
        "np.maximum(0.0 * _doubt(exemplar)",
        _INDEX,
    ),
    Fault(
        "index: single marks are no reason",
        "example/index.py",
        "_MOST * _resized(unique",
        "0 * _resized(unique",
        _INDEX,
    ),
    Fault(
        "index: a place is most like itself",
        "example/similar.py",
        "(found < best) & ~near",
        "found < best",
        (*_INDEX, "tests/example/test_example_index.py"),
    ),
    Fault(
        "field: nothing is dear",
        "example/lookup.py",
        "price = np.square(index.reluctance, dtype=np.int32)",
        "price = 0 * np.square(index.reluctance, dtype=np.int32)",
        _INDEX,
    ),
    Fault(
        "field: odd rows",
        "example/coordinates.py",
        "fine[(1 - first_y) :: 2, :, 1]",
        "fine[first_y::2, :, 1]",
        _INDEX,
    ),
    Fault(
        "field: the least height is forgotten",
        "example/example.py",
        "found[-1] += np.float32(low * unit)",
        "found[-1] += 0.0",
        _INDEX,
    ),
    Fault(
        "field: the same row of finer texels",
        "example/example.py",
        "np.tile(within, coarse.height)[:, None]",
        "0",
        (*_INDEX, "-k", "resolution"),
    ),
    Fault(
        "field: relief is not blended",
        "example/relief.py",
        "        height = _filtered(height, k)\n        cut",
        "        height = height[1 << k : -(1 << k), 1 << k : -(1 << k)].copy()\n        cut",
        ("tests/example/test_example_relief.py",),
    ),
    Fault(
        "draws: without the order of what they are near",
        "space/prior/anchors.py",
        "here[CODE_SIZE:], self.waves)",
        "here[CODE_SIZE:], ())",
        ("tests/space/prior/test_anchors.py",),
    ),
    Fault(
        "noise: streaks as wide as they are long",
        "space/grains.py",
        "((40, 3), (3, 40), (120, 8), (8, 120))",
        "((40, 40), (40, 40), (120, 120), (120, 120))",
        ("tests/space/test_grains.py", "-k", "streak"),
    ),
    Fault(
        "noise: a period that does not fit its cells",
        "space/grains.py",
        "[cell % count for cell in around] if count else around",
        "around",
        ("tests/space/test_grains.py", "-k", "period"),
    ),
    Fault(
        "between: stripes told backwards",
        "space/between.py",
        "1.0 if a.fx * b.fx + a.fy * b.fy >= 0 else -1.0",
        "1.0",
        ("tests/space/test_between.py", "-k", "backwards"),
    ),
    Fault(
        "between: statistics of the first",
        "space/between.py",
        "tuple(freeze(decoder, code, waves))",
        "first.moments",
        ("tests/space/test_between.py", "-k", "middle"),
    ),
    Fault(
        "file: heights are rounded down",
        "example/exemplar.py",
        "np.rint(height.astype(np.float64) / unit)",
        "np.floor(height.astype(np.float64) / unit)",
        ("tests/example/test_exemplar.py",),
    ),
    Fault(
        "file: any version",
        "field/header.py",
        'if about["version"] != VERSION:',
        "if False:",
        ("tests/field/test_endless_field.py", "-k", "test_damaged_materials_are_refused_by_name"),
    ),
    Fault(
        "blend: sinks instead of rising",
        "synth/blend.py",
        "(2.0 * share - 1.0)",
        "(1.0 - 2.0 * share)",
        _MASK,
    ),
    Fault(
        "blend: what has risen stays", "synth/blend.py", "+ level - rise * share", "+ level", _MASK
    ),
    Fault(
        "blend: one mean for both",
        "synth/blend.py",
        "(self.means[1] - self.means[0]) * share",
        "0.0 * share",
        _MASK,
    ),
    Fault(
        "blend: a peak reaches through at the ends",
        "synth/blend.py",
        "        seen = seen.clamp(1.0 - _ENDS * (1.0 - share), _ENDS * share)\n",
        "",
        _MASK,
    ),
    Fault(
        "mask: upside down",
        "synth/mask.py",
        "upper * (1.0 - from_bottom[:, None]) + lower * from_bottom[:, None]",
        "lower * (1.0 - from_bottom[:, None]) + upper * from_bottom[:, None]",
        _MASK,
    ),
    Fault(
        "mask: half a pixel aside",
        "synth/mask.py",
        "(pixels / (2.0 * length)) - 0.5",
        "(pixels / (2.0 * length))",
        _MASK,
    ),
    Fault(
        "mask: its border does not join",
        "synth/mask.py",
        "(before + 1) % pixels",
        "np.clip(before + 1, 0, pixels - 1)",
        _MASK,
    ),
)

PICTURES = (
    Fault(
        "suns: the search never ends in a starry sky",
        "relight/environment_map.py",
        "limit, raised = 1.5 * limit, True",
        "break",
        ("tests/relight/test_relight_environment.py", "-k", "search"),
    ),
    Fault(
        "sampling: levels half a texel aside",
        "relight/loops/reading.c",
        "column = (column + 0.5) * ((double)width / t->widths[0]) - 0.5;",
        "column = column * ((double)width / t->widths[0]);",
        swept("squares"),
    ),
    Fault(
        "sampling: variance is dropped",
        "relight/sampling.py",
        "np.maximum(square - mean, 0.0)",
        "0.0",
        swept("squares"),
    ),
    Fault(
        "sampling: alpha is averaged, not its square",
        "relight/sampling.py",
        "np.square(self._alpha)[None]",
        "self._alpha[None]",
        swept("squares"),
    ),
    Fault(
        "sampling: normals lean to the other side",
        "relight/sampling.py",
        "(-x * z, -y * z, z)",
        "(-x * z, y * z, z)",
        swept("squares"),
    ),
    Fault(
        "sampling: rows upwards",
        "relight/sampling.py",
        "(height - 1) / 2.0 - place[1] * step",
        "(height - 1) / 2.0 + place[1] * step",
        swept("squares"),
    ),
    Fault(
        "tables: no light at grazing",
        "relight/tables.py",
        "z = (1.0 - point.u)",
        "z = (0.9 - point.u)",
        swept("environments"),
    ),
    Fault(
        "compensation: twice",
        "relight/effects/multiscatter.py",
        "    strength: Array = fresnel * fresnel",
        "    strength: Array = 2.0 * fresnel * fresnel",
        swept("furnace"),
    ),
    Fault(
        "meshes: what lies behind is seen",
        "relight/surfaces/mesh.py",
        "depth < depths[pixel]",
        "depth > depths[pixel]",
        ("tests/relight/test_relight_surfaces.py", "-k", "mesh"),
    ),
    Fault(
        "shadows: rows that are columns",
        "relight/loops/loops.h",
        "!crossed(f, -y, x, row, column,",
        "!crossed(f, -y, x, column, row,",
        swept("shadows"),
    ),
    Fault(
        "metallic: bases are not brighter",
        "export/metallic.py",
        "diffuse / np.maximum(rest, 1e-6)",
        "diffuse",
        swept("metallic"),
    ),
    Fault(
        "metallic: half as much",
        "export/metallic.py",
        "specular > wanted.highest, high * allowed, 0.0",
        "specular > wanted.highest, 0.5 * high * allowed, 0.0",
        swept("metallic"),
    ),
    Fault(
        "textures: the curve is not undone",
        "export/texture_file.py",
        "colours[...] = srgb_decode(colours)",
        "pass",
        swept("textures"),
    ),
    Fault(
        "textures: codes are cut, not rounded",
        "files/png.py",
        "np.rint(np.clip(coded, 0.0, 1.0)",
        "np.floor(np.clip(coded, 0.0, 1.0)",
        swept("textures"),
    ),
    Fault(
        "glTF: bases are not compensated",
        "export/specular_workflow.py",
        "* share",
        "* (0.0 * share + 1.0)",
        ("tests/export/test_export_gltf.py",),
    ),
    Fault(
        "metallic: what is further is taken",
        "export/metallic.py",
        "other.off < self.off - _BETTER",
        "other.off > self.off - _BETTER",
        ("tests/export/test_export_presets.py", "-k", "TestMetallic"),
    ),
    Fault(
        "presets: metals have one form",
        "export/presets.py",
        "forms = [replace(self, form=form) for form in FORMS]",
        "forms = [self]",
        ("tests/export/test_export_presets.py", "-k", "TestForms"),
    ),
    Fault(
        "glTF: browsers read 16 bits",
        "export/texture_file.py",
        "np.clip(whole, least, least + np.uint16(255))",
        "whole",
        ("tests/export/test_export_gltf.py",),
    ),
    Fault(
        "glTF: metallic for roughness",
        "export/gltf.py",
        "[occluded, told_roughness(piece, SHADING), flat]",
        "[occluded, flat, told_roughness(piece, SHADING)]",
        ("tests/export/test_export_gltf.py",),
    ),
    Fault(
        "glTF: upside down",
        "export/gltf.py",
        "[(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]",
        "[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]",
        ("tests/export/test_export_gltf.py",),
    ),
    Fault(
        "presets: green turned around",
        "export/textures.py",
        "coded[..., 1] = np.float32(1.0) - coded[..., 1]",
        "coded[..., 0] = np.float32(1.0) - coded[..., 0]",
        ("tests/export/test_export_presets.py",),
    ),
    Fault(
        "presets: roughness for smoothness",
        "export/engines.py",
        'picture("occlusion"), 1.0 - material.roughness',
        'picture("occlusion"), material.roughness',
        ("tests/export/test_export_presets.py", "-k", "unity"),
    ),
    Fault(
        "map sets: another axis turned around",
        "brdf/folder.py",
        "np.array([1.0, -1.0, 1.0]",
        "np.array([-1.0, 1.0, 1.0]",
        ("tests/brdf/test_mapset.py", "-k", "directx"),
    ),
    Fault(
        "map sets: heights in half float",
        "brdf/folder.py",
        'half=kind != "height"',
        "half=True",
        ("tests/brdf/test_mapset.py", "-k", "gives_back"),
    ),
    Fault(
        "map sets: middle grey below the least height",
        "brdf/folder.py",
        "-low / (high - low)",
        "low / (high - low)",
        ("tests/brdf/test_mapset.py", "-k", "pngs"),
    ),
)

SHOOTS_AND_PAGE = (
    Fault(
        "batch: a RAW and its JPEG are two",
        "batch/shoot.py",
        "kind(path) in _CAMERA and raw is None",
        "kind(path) in _CAMERA",
        _SHOOT,
    ),
    Fault(
        "batch: the gap counts from the first",
        "batch/shoot.py",
        "            runs.append([shot])\n        last = when",
        "            runs.append([shot])\n            last = when",
        _SHOOT,
    ),
    Fault(
        "batch: names of its own files",
        "batch/shoot.py",
        "plain.casefold() in _TAKEN",
        "False",
        _SHOOT,
    ),
    Fault(
        "batch: some failed is done",
        "batch/run.py",
        "ExitCode.SOME_FAILED if good",
        "ExitCode.DONE if good",
        ("tests/batch/test_run.py",),
    ),
    Fault(
        "page: any host",
        "view/server.py",
        "not in self._address.hosts",
        "is None",
        ("tests/view/test_view_server.py",),
    ),
    Fault(
        "page: any token",
        "view/server.py",
        "elif not known or not slash:",
        "elif not slash:",
        ("tests/view/test_view_server.py",),
    ),
    Fault(
        "page: names end its script",
        "view/document.py",
        '.replace("<", "\\\\u003c")',
        "",
        ("tests/view/test_view_command.py", "-k", "break_out"),
    ),
    Fault(
        "adjusting: normals keep the old relief",
        "brdf/adjust.py",
        "found[-3:-1] *= factor",
        "found[-3:-1] *= 1.0",
        ("tests/brdf/test_adjust.py",),
    ),
    Fault(
        "page: slopes upside down",
        "view/moments.py",
        "height[: -2 * RING, RING:-RING] - height[2 * RING :, RING:-RING]",
        "height[2 * RING :, RING:-RING] - height[: -2 * RING, RING:-RING]",
        ("tests/view/test_view_server.py",),
    ),
    Fault(
        "page: green and blue of F0 are its red and green",
        "view/pages.py",
        "_halves(moments[ALBEDO][4:])",
        "_halves(moments[ALBEDO][3:-1])",
        ("tests/view/test_view_coloured.py", "-k", "green_and_blue"),
    ),
    Fault(
        "page: a tile does not say that F0 has a colour",
        "view/enclosed.py",
        '"specular_channels": len(maps.specular)',
        '"specular_channels": 1',
        ("tests/view/test_view_coloured.py", "-k", "says_how_many"),
    ),
    Fault(
        "plain DNG: little-endian whatever the file",
        "photo/jxl.py",
        'samples.astype(f"{order}u2")',
        'samples.astype("<u2")',
        ("tests/photo/test_jxl.py", "-k", "uncompressed"),
    ),
    Fault(
        "photographs: colours of the matrix's other side",
        "files/color.py",
        "self.matrix.T.astype",
        "self.matrix.astype",
        ("tests/photo/test_color.py",),
    ),
    Fault(
        "photographs: turned the other way",
        "photo/orient.py",
        "orientation in (2, 3, 6, 7)",
        "orientation in (2, 3, 5, 7)",
        ("tests/photo/test_exif.py", "-k", "pillow"),
    ),
    Fault(
        "photographs: no noise in the dark",
        "photo/sensor_noise.py",
        "np.sqrt(self.shot * signal + self.read)",
        "np.sqrt(self.shot * signal)",
        ("tests/photo/test_noise.py", "-k", "variance"),
    ),
    Fault(
        "statistics: means in covariances",
        "statistics/gram.py",
        "    one = one - one.mean(dim=1, keepdim=True)\n",
        "",
        ("tests/statistics/test_gram.py",),
    ),
    Fault(
        "statistics: power of another unit",
        "statistics/spectrum.py",
        "window.square().sum()",
        "window.sum()",
        ("tests/statistics/test_spectrum.py",),
    ),
)

METALS = (
    Fault(
        "colour: metals compared as if all were grey",
        "example/features.py",
        "diffuse + specular if coloured else diffuse",
        "diffuse",
        ("tests/example/test_coloured_example.py", "-k", "by_their_colour"),
    ),
    Fault(
        "colour: shares of rust are light",
        "example/repeat/level.py",
        "if len(maps[SPECULAR]) == COLOURED else ()",
        "if False else ()",
        ("tests/example/test_coloured_example.py", "-k", "slow_light"),
    ),
    Fault(
        "colour: gloss of green",
        "brdf/adjust.py",
        "(4, 5) if not coloured else (6, 7)",
        "(4, 5)",
        ("tests/brdf/test_coloured_files.py", "-k", "gloss"),
    ),
    Fault(
        "colour: any number of channels",
        "brdf/stated.py",
        "isinstance(found, bool) or found not in (1, 3)",
        "False",
        ("tests/brdf/test_coloured_files.py", "-k", "agree"),
    ),
    Fault(
        "colour: the plan looks at red",
        "relight/texture.py",
        "float(self.specular.max())",
        "float(self.specular[0].max())",
        ("tests/relight/test_relight_coloured.py", "-k", "knows_the_brightest"),
    ),
)

_KEYPOINTS = "tests/flash/registration/test_keypoints.py"
_ALIGN = "tests/capture/together/test_alignment.py"

SEVERAL = (
    Fault(
        "several: features a quarter of a pixel beside their places",
        "flash/registration/keypoints.py",
        "enable_precise_upscale=True",
        "enable_precise_upscale=False",
        (_KEYPOINTS, "-k", "whichever_way"),
    ),
    Fault(
        "several: no match votes",
        "flash/registration/keypoints.py",
        "if chosen.sum() < settings.enough:",
        "if False:",
        (_KEYPOINTS, "-k", "one_match_in_thirty"),
    ),
    Fault(
        "several: the best one way only",
        "flash/registration/keypoints.py",
        "clear & (back[nearest] == np.arange(len(first)))",
        "clear",
        (_KEYPOINTS, "-k", "both_ways"),
    ),
    Fault(
        "several: shading leaves no doubt",
        "flash/registration/doubt.py",
        "return covariance + np.outer(moved, moved)",
        "return covariance",
        ("tests/flash/registration/test_doubt.py", "-k", "is_said"),
    ),
    Fault(
        "several: moved twice as far as they lie astray",
        "capture/together/shared.py",
        "np.float32) / 12.0",
        "np.float32) / 24.0",
        (_ALIGN, "-k", "no_farther"),
    ),
    Fault(
        "several: those that are held move",
        "capture/together/shared.py",
        "1e-9 if number in held else",
        "1e-9 if False else",
        (_ALIGN, "-k", "held_stays"),
    ),
    Fault(
        "several: sure photographs are moved",
        "capture/together/align.py",
        "moving = len(sure) < len(views)",
        "moving = True",
        (_ALIGN, "-k", "are_sure_stay"),
    ),
    Fault(
        "several: every pattern repeats itself",
        "flash/registration/period.py",
        "likeness_further(photo) > PERIOD.alike",
        "likeness_further(photo) > 0.0 * PERIOD.alike",
        ("tests/flash/registration/test_period.py", "-k", "grain"),
    ),
)

FAULTS = (*RELIGHTING_AND_FILES, *CAPTURE, *FIELD, *PICTURES, *SHOOTS_AND_PAGE, *METALS, *SEVERAL)
