"""The binary, by a reader of its own and by Khronos's validator."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from exported import MATERIALS, channels, linear

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.export.surface import Surface, residual
from matcap.export.targets import write_export
from matcap.export.textures import Job

ROOT = Path(__file__).parents[2]


def opened(path):
    """(JSON document, function from a buffer view's number to its bytes)."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(content[20 : 20 + size])
    start = 28 + size
    rest, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert (kind, rest % 4, start + rest) == (b"BIN\0", 0, len(content))
    assert document["buffers"] == [{"byteLength": rest}]

    def view(number):
        one = document["bufferViews"][number]
        assert one["byteOffset"] % 4 == 0
        return content[start + one["byteOffset"] :][: one["byteLength"]]

    return document, view


@pytest.mark.parametrize("depth", [None, "8", "16"])
@pytest.mark.parametrize("name", MATERIALS)
def test_its_material_gives_the_light_of_the_maps(tmp_path, made, name, depth):
    """As the specification and its two extensions say, and no other way."""
    done = write_export(Job(made[name], name, depth=depth), "gltf", tmp_path)
    document, view = opened(tmp_path / f"{name}.glb")
    (material,) = document["materials"]
    assert set(document["extensionsUsed"]) == set(material["extensions"])

    def read(texture):
        image = document["images"][document["textures"][texture["index"]]["source"]]
        raw = np.frombuffer(view(image["bufferView"]), dtype=np.uint8)
        stored = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
        return channels(stored[..., ::-1] / np.float64(np.iinfo(stored.dtype).max))

    rough = material["pbrMetallicRoughness"]
    assert (rough["metallicFactor"], rough["roughnessFactor"]) == (0.0, 1.0)
    ior = material["extensions"]["KHR_materials_ior"]["ior"]
    tint = material["extensions"]["KHR_materials_specular"]
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2
    colour = torch.from_numpy(linear(read(tint["specularColorTexture"]).numpy()))
    f0 = (f0 * tint["specularColorFactor"][0] * colour).clamp(max=1.0)
    seen = Surface(
        torch.from_numpy(linear(read(rough["baseColorTexture"]).numpy())),
        f0,
        read(rough["metallicRoughnessTexture"])[1:2],
        2.0 * read(material["normalTexture"]) - 1.0,
        layer=f0.amax(dim=0, keepdim=True),
    )
    off = residual(made[name], seen)
    assert off.mean == pytest.approx(done.residual.mean, rel=1e-3)
    if depth != "8":
        assert off.mean < 0.01


def test_the_plane_is_as_large_as_the_maps(tmp_path, made):
    write_export(Job(made["leather"], "leather", millimetres=90.0), "gltf", tmp_path)
    document, view = opened(tmp_path / "leather.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    assert accessor["max"] == pytest.approx([0.09, 0.06, 0.0])
    points = np.frombuffer(view(accessor["bufferView"]), dtype="<f4").reshape(-1, 3)
    assert points.max(axis=0) == pytest.approx(accessor["max"])
    faces = np.frombuffer(
        view(document["accessors"][primitive["indices"]]["bufferView"]), dtype="<u2"
    ).reshape(-1, 3)
    a, b, c = (points[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()  # both triangles face the viewer
    spots = document["accessors"][primitive["attributes"]["TEXCOORD_0"]]
    uv = np.frombuffer(view(spots["bufferView"]), dtype="<f4").reshape(-1, 2)
    top = points[:, 1] > 0.0
    assert (uv[top, 1] == 0.0).all()  # a picture's first row is the top
    assert (uv[~top, 1] == 1.0).all()


@pytest.mark.parametrize("f0", [0.0, 0.04, 0.2, 0.95, 1.0])
def test_any_f0_is_kept(tmp_path, f0):
    flat = torch.zeros(1, 8, 8)
    maps = MapSet(flat.expand(3, 8, 8), flat + f0, flat + 0.5, flat, 0.1)
    assert write_export(Job(maps, "even"), "gltf", tmp_path).residual.worst < 0.02


def test_more_light_than_a_layer_allows_is_told(tmp_path):
    flat = torch.zeros(1, 8, 8)
    maps = MapSet(flat.expand(3, 8, 8) + 0.9, flat + 0.5, flat + 0.5, flat, 0.1)
    done = write_export(Job(maps, "bright"), "gltf", tmp_path)
    assert "clipped" in done.notes[0]
    assert done.residual.mean > 0.1


def test_floats_are_refused(tmp_path, made):
    with pytest.raises(UsageError, match="no textures of floats"):
        write_export(Job(made["leather"], "leather", depth="half"), "gltf", tmp_path)


@pytest.fixture
def issues():
    """What Khronos's validator says of a file: numbers of errors and warnings."""
    place = ROOT / ".node" / "node_modules" / "gltf-validator"
    if shutil.which("node") is None or not place.is_dir():
        pytest.skip("needs node, and `npm install --prefix .node gltf-validator`")
    code = (
        "const [place, file] = process.argv.slice(1);"
        "require(place).validateBytes(new Uint8Array(require('fs').readFileSync(file)))"
        ".then(r => console.log(JSON.stringify(r.issues)))"
    )

    def run(path):
        command = ["node", "-e", code, str(place), str(path)]
        said = subprocess.run(command, capture_output=True, text=True, check=True)
        found = json.loads(said.stdout)
        return found["numErrors"], found["numWarnings"]

    return run


@pytest.mark.parametrize("depth", ["8", "16"])
def test_the_validator_finds_nothing(tmp_path, made, issues, depth):
    write_export(Job(made["rust"], "rust", 85.0, depth), "gltf", tmp_path)
    assert issues(tmp_path / "rust.glb") == (0, 0)
    broken = (tmp_path / "rust.glb").read_bytes().replace(b'"VEC3"', b'"VEC4"')
    (tmp_path / "rust.glb").write_bytes(broken)
    assert issues(tmp_path / "rust.glb")[0] > 0
