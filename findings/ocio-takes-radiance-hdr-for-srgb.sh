#!/usr/bin/env bash
# OpenColorIO's built-in configurations take a Radiance .hdr file for a picture of the sRGB curve.
#
# Behaviour: their rules know the extension .exr (ACES2065-1); every other file is "sRGB - Display",
# environment.hdr and normal.png as well. A program that asks getColorSpaceFromFilepath, as the
# documentation advises, decodes linear radiance once more: 0.5 becomes 0.21, 4 becomes 25.
# Why it matters: environment maps come as .hdr; lit by them through these rules a scene is too
# contrasty by a power of 2.4. An EXR with Rec. 709's primaries is read by those of ACES.
# Seen on 2026-11-30:
#   opencolorio 2.6.0
#   cg-config-latest: environment.hdr sRGB - Display, albedo.exr ACES2065-1; 0.5 becomes 0.214, 4 becomes 25.3
#   studio-config-latest: environment.hdr sRGB - Display, albedo.exr ACES2065-1; 0.5 becomes 0.214, 4 becomes 25.3
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencolorio==2.6.0
venv/bin/python - <<'PY'
import PyOpenColorIO as ocio

print("opencolorio", ocio.__version__)
for name in ("cg-config-latest", "studio-config-latest"):
    config = ocio.Config.CreateFromFile(f"ocio://{name}")
    spaces = [config.getColorSpaceFromFilepath(f)[0] for f in ("environment.hdr", "albedo.exr")]
    processor = config.getProcessor(spaces[0], "Linear Rec.709 (sRGB)").getDefaultCPUProcessor()
    half, four = (processor.applyRGB([value] * 3)[0] for value in (0.5, 4.0))
    print(f"{name}: environment.hdr {spaces[0]}, albedo.exr {spaces[1]}; "
          f"0.5 becomes {half:.3f}, 4 becomes {four:.1f}")
    assert spaces == ["sRGB - Display", "ACES2065-1"] and half < 0.25, "changed"
PY
