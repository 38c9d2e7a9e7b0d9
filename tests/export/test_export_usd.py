"""Stage and package through usd-core."""

import struct
import zipfile

import cv2
import numpy as np
import pytest
from exported import MATERIALS, channels, linear

from matcap.errors import UsageError
from matcap.export.surface import Surface, residual
from matcap.export.targets import write_export
from matcap.export.textures import Job


@pytest.fixture
def complaints():
    """Everything that the validators of usd-core say of a file."""
    pytest.importorskip("pxr", reason="needs the extra `export`")
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    context = UsdValidation.ValidationContext(validators)
    return lambda path: [
        error.GetMessage() for error in context.Validate(Usd.Stage.Open(str(path)))
    ]


@pytest.mark.parametrize("suffix", ["usda", "usdz"])
@pytest.mark.parametrize("name", ["leather", "2001 façade-1"])
def test_it_is_valid(tmp_path, made, complaints, suffix, name):
    write_export(Job(made["leather"], name, millimetres=90.0), "usd", tmp_path)
    assert complaints(tmp_path / f"{name}.{suffix}") == []


def test_the_validators_would_object(tmp_path, made, complaints):
    write_export(Job(made["leather"], "leather"), "usd", tmp_path)
    file = tmp_path / "leather.usda"
    file.write_text(file.read_text().replace("color3f inputs:diff", "float inputs:diff"))
    assert complaints(file)


@pytest.mark.parametrize("suffix", ["usda", "usdz"])
@pytest.mark.parametrize("name", MATERIALS)
def test_its_network_gives_the_light_of_the_maps(tmp_path, made, name, suffix):
    pytest.importorskip("pxr", reason="needs the extra `export`")
    from pxr import Ar, Usd, UsdGeom, UsdShade

    write_export(Job(made[name], name, millimetres=90.0), "usd", tmp_path)
    if suffix == "usdz":
        for file in tmp_path.glob("*.png"):
            file.unlink()  # so that only the package's own can be read
    stage = Usd.Stage.Open(str(tmp_path / f"{name}.{suffix}"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(0.09)
    mesh = stage.GetPrimAtPath(f"/{name}/Plane")
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetInput("useSpecularWorkflow").Get() == 1

    def read(input_):
        source = surface.GetInput(input_).GetConnectedSources()[0][0]
        shader, channel = UsdShade.Shader(source.source.GetPrim()), source.sourceName
        asset = Ar.GetResolver().OpenAsset(
            Ar.ResolvedPath(shader.GetInput("file").Get().resolvedPath)
        )
        raw = np.frombuffer(bytes(asset.GetBuffer()), dtype=np.uint8)
        stored = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
        coded = stored / np.float64(np.iinfo(stored.dtype).max)
        coded = coded[..., ::-1] if coded.ndim == 3 else coded
        if shader.GetInput("sourceColorSpace").Get() == "sRGB":
            coded = linear(coded)
        scale, bias = (shader.GetInput(key) for key in ("scale", "bias"))
        if scale:
            coded = coded * scale.Get()[0] + bias.Get()[0]
        assert channel in ("r", "rgb")
        return channels(coded)

    f0 = read("specularColor")
    seen = Surface(read("diffuseColor"), f0, read("roughness"), read("normal"), layer=f0)
    off = residual(made[name], seen)
    assert off.mean < 0.01
    assert off.worst < 0.02
    height = made[name].height
    assert (read("displacement") - height).abs().max() < 1e-4 * float(height.max() - height.min())


def test_files_lie_at_multiples_of_64_bytes(tmp_path, made):
    write_export(Job(made["leather"], "leather"), "usd", tmp_path)
    path = tmp_path / "leather.usdz"
    content = path.read_bytes()
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None
        assert package.namelist()[0] == "leather.usda"
        for info in package.infolist():
            assert info.compress_type == zipfile.ZIP_STORED
            name, extra = struct.unpack_from("<HH", content, info.header_offset + 26)
            assert (info.header_offset + 30 + name + extra) % 64 == 0


def test_floats_are_refused(tmp_path, made):
    with pytest.raises(UsageError, match="PNGs only"):
        write_export(Job(made["leather"], "leather", depth="half"), "usd", tmp_path)
