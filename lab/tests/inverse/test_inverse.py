"""Real materials in one file: packed, cut into pieces, photographed, held out."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from matcap.brdf.maps import HEIGHT, normals_from_height
from matcap.capture.exemplar.network.network import (
    ANSWERS,
    ERRORS,
    Inverse,
    InverseConfig,
    network_inputs,
    read_inverse,
)
from matcap.errors import MatcapError
from matcap_lab.inverse.evaluate import (
    calibration,
    evaluate,
    photograph_as_albedo,
    relit_error,
    score,
    table,
)
from matcap_lab.inverse.samples import (
    LEVELS,
    PackedSet,
    Sample,
    coloured_metal,
    cut,
    draw_sample,
    halved,
    held_out_sets,
    is_held_out,
    open_pack,
    pack,
    real_piece,
    training_material,
    training_sets,
)
from matcap_lab.inverse.train import (
    TrainSettings,
    loss_parts,
    save_inverse,
    ship,
    start,
    step_loss,
    total,
    train,
    wanted,
)
from matcap_lab.simulate.named import random_material

SIDE = 64
NAMES = tuple(f"material{i}" for i in range(12))


def relief(phase: float = 0.0) -> np.ndarray:
    """(1, SIDE, SIDE) periodic height in texels."""
    y, x = np.mgrid[:SIDE, :SIDE] * 2.0 * math.pi / SIDE
    waves = 3.0 * np.sin(2.0 * x + phase) + 1.5 * np.cos(3.0 * y - x) + np.sin(5.0 * y)
    return waves[None].astype(np.float32)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    rng = np.random.default_rng(0)
    for index, name in enumerate(NAMES):
        (folder / name).mkdir()
        normal = normals_from_height(torch.from_numpy(relief(index)), 1.0, periodic=True)
        coded = np.rint((normal.numpy() * 0.5 + 0.5) * 255.0).astype(np.uint8)
        cv2.imwrite(str(folder / name / "normal.png"), coded.transpose(1, 2, 0)[..., ::-1])
        colour = rng.integers(40, 200, (SIDE, SIDE, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / name / "basecolor.png"), colour)
        cv2.imwrite(str(folder / name / "roughness.png"), colour[..., 0])
        if index == 0:
            metal = np.full((SIDE, SIDE), 255, np.uint8)
            cv2.imwrite(str(folder / name / "metallic.png"), metal)
    assert pack(folder, folder / "maps.pack") == len(NAMES)
    return folder / "maps.pack"


def picture(path: Path) -> np.ndarray:
    """(H, W, 3) in [0, 1]."""
    read = cv2.imread(str(path))
    assert read is not None
    return np.asarray(read[..., ::-1], np.float32) / 255.0


def sets(packed: Path) -> tuple[PackedSet, ...]:
    return tuple(open_pack(packed).values())


def test_packed_maps_are_the_sets(packed: Path) -> None:
    assert tuple(open_pack(packed)) == tuple(sorted(NAMES))
    plain = open_pack(packed)["material1"]
    assert [s.shape for s in plain.surface] == [(8, SIDE >> i, SIDE >> i) for i in range(LEVELS)]
    assert plain.surface[0].dtype == torch.float16
    folder = packed.parent / "material1"
    roughness = picture(folder / "roughness.png")[..., 0]
    assert np.allclose(plain.surface[0][6].float().numpy(), roughness, atol=1e-3)
    colour = picture(folder / "basecolor.png")
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    assert np.allclose(plain.surface[0][:3].float().numpy().transpose(1, 2, 0), linear, atol=1e-3)
    assert np.allclose(plain.surface[0][3:6].float(), 0.04, atol=1e-4)
    metal = open_pack(packed)["material0"].surface[0].float()
    assert float(metal[:3].max()) == 0.0 and float(metal[7].min()) == 1.0
    off = normals_from_height(plain.height[0], 1.0, periodic=True) - normals_from_height(
        torch.from_numpy(relief(1)), 1.0, periodic=True
    )
    assert float(off.abs().mean()) < 0.01


def test_slopes_lost_by_halving_count_as_roughness() -> None:
    surface = np.full((8, SIDE, SIDE), 0.3, np.float32)
    rough = np.zeros((1, SIDE, SIDE), np.float32)
    rough[0] = np.sin(np.arange(SIDE) * math.pi / 2.0)  # waves of four texels
    even, _ = halved(surface, 0.0 * rough)
    lost, height = halved(surface, rough)
    assert np.allclose(even, 0.3, atol=1e-5)
    assert float(lost[6].mean()) > 0.5
    assert height.shape == (1, SIDE // 2, SIDE // 2)


def test_the_split_is_by_name_and_disjoint(packed: Path) -> None:
    trained = {s.name for s in training_sets(packed)}
    left = {s.name for s in held_out_sets(packed)}
    assert trained | left == set(NAMES)
    assert not trained & left
    assert left == {name for name in NAMES if is_held_out(name)}
    shares = sum(is_held_out(f"some material {i}") for i in range(2000)) / 2000
    assert shares == pytest.approx(0.2, abs=0.03)


def test_pieces_keep_slopes_at_every_scale(packed: Path) -> None:
    whole = sets(packed)[1]
    steepness = float(np.square(np.gradient(relief(1)[0])).sum(0).mean())
    for scale in (0.8, 1.0, 2.0):
        piece = cut(whole, 0, scale, np.random.default_rng(4), 96, 80)
        assert piece.shape == (9, 80, 96)
        assert np.square(np.gradient(piece[-1])).sum(0).mean() == pytest.approx(steepness, rel=0.25)


def test_pieces_of_real_materials_are_maps(packed: Path) -> None:
    for seed in range(20):
        maps, metal = real_piece(sets(packed), np.random.default_rng(seed), 72, 56)
        assert maps.size == (72, 56) and metal.shape == (1, 56, 72)
        stacked = maps.stacked()
        assert bool(torch.isfinite(stacked).all())
        assert float(stacked[:-1].min()) > 0.0 and float(stacked[:-1].max()) <= 1.0
        assert float(metal.min()) >= 0.0 and float(metal.max()) <= 1.0


def test_metal_is_drawn_in_colours_and_what_is_none_stays_grey() -> None:
    f0 = np.full((3, 8, 8), 0.5, np.float32)
    metal = np.ones((1, 8, 8), np.float32)
    metal[:, :4], f0[:, :4] = 0.0, 0.04
    hues = []
    for seed in range(40):
        drawn = coloured_metal(f0, metal, np.random.default_rng(seed))
        assert np.array_equal(drawn[:, :4], f0[:, :4])
        bare = drawn[:, 6, 6]
        assert bare.min() > 0.0 and bare.max() < 1.0
        hues.append(float(bare.max() / bare.min()))
    assert min(hues) == 1.0 and max(hues) > 3.0
    plain = coloured_metal(0.08 * f0, 0.0 * metal, np.random.default_rng(0))
    assert np.array_equal(plain, 0.08 * f0)


def test_other_files_are_no_packed_maps(tmp_path: Path) -> None:
    (tmp_path / "maps.pack").write_bytes(b"nothing of the kind")
    with pytest.raises(MatcapError, match="pack of maps cannot be read"):
        open_pack(tmp_path / "maps.pack")
    with pytest.raises(MatcapError, match="no map sets"):
        pack(tmp_path, tmp_path / "out.pack")


# Training of the inverse network: samples, losses, runs that continue one another.

TINY = InverseConfig(widths=(8, 8, 8, 8, 8), context=8)
SMALL = TrainSettings(width=64, height=64, workers=0)


def legs(folder: Path, steps: int, config: InverseConfig = TINY, begin: Path | None = None):
    return train(folder, replace(SMALL, steps=steps), config, lambda _line: None, begin)


@pytest.mark.parametrize("real", [0.0, 1.0])
def test_a_sample_is_a_function_of_its_number(packed: Path, real: float) -> None:
    first, again, other = (
        draw_sample(number, 64, 64, sets=sets(packed), real=real) for number in (5, 5, 6)
    )
    assert torch.equal(first.linear, again.linear)
    assert torch.equal(first.truth.stacked(), again.truth.stacked())
    assert first.uniform == again.uniform
    assert not torch.equal(first.linear, other.linear)


def test_samples_are_finite_and_within_range() -> None:
    for number in range(12):
        sample = draw_sample(number, 96, 64)
        inputs = network_inputs(sample.linear, sample.valid, sample.uniform, sample.points)
        assert bool(torch.isfinite(inputs.stacked()).all())
        assert bool(torch.isfinite(sample.truth.stacked()).all())
        assert float(sample.linear.min()) >= 0.0 and float(sample.linear.max()) <= 1.0
        # The coarse fit is about as bright as the picture.
        assert float(inputs.log.median().abs()) < 1.0


def test_held_out_patterns_are_never_trained_on() -> None:
    shown = [random_material(np.random.default_rng(seed)) for seed in range(200)]
    assert any(material.is_held_out for material in shown)
    for seed in range(40):
        owner = getattr(training_material(np.random.default_rng(seed)), "__self__", None)
        assert owner is None or not hasattr(owner, "base") or not owner.is_held_out


def test_the_truth_has_no_loss_but_doubt() -> None:
    sample = draw_sample(10, 96, 64)
    truth = sample.residuals.stacked()
    certain = torch.full((ERRORS, *truth.shape[-2:]), float(np.log(0.01)))
    true = wanted([sample], np.random.default_rng(0))
    sure = torch.where(sample.metal > 0.5, 20.0, -20.0)
    parts = loss_parts(torch.cat([truth, certain, sure])[None], true)
    for name, part in parts.items():
        assert float(part) < 2e-3, name
    wrong = truth.clone()
    wrong[HEIGHT] *= 0.3
    shrunk = loss_parts(torch.cat([wrong, certain, sure])[None], true)
    assert float(shrunk["energy"]) > 0.1
    assert float(shrunk["slope"]) > 0.1


def test_legs_continue_exactly(tmp_path: Path) -> None:
    whole = legs(tmp_path / "whole", 4)
    legs(tmp_path / "runs", 2)
    resumed = legs(tmp_path / "runs", 4)
    assert resumed.step == whole.step == 4
    for a, b in zip(whole.model.parameters(), resumed.model.parameters(), strict=True):
        assert torch.equal(a, b)


def test_a_step_of_two_pictures_is_the_mean_of_theirs() -> None:
    samples = [draw_sample(number, 64, 64) for number in (1, 2)]
    outputs = 0.1 * torch.randn(2, ANSWERS, 64, 64, generator=torch.Generator().manual_seed(0))
    rng = np.random.default_rng(0)
    both = loss_parts(outputs, wanted(samples, rng))
    rng = np.random.default_rng(0)  # which draws the lights of one after the other
    each = [loss_parts(outputs[i : i + 1], wanted(samples[i : i + 1], rng)) for i in (0, 1)]
    for name, part in both.items():
        assert float(part) == pytest.approx(sum(float(e[name]) for e in each) / 2, rel=1e-4), name


def test_a_first_leg_goes_on_from_a_shipped_network(tmp_path: Path) -> None:
    torch.manual_seed(3)
    save_inverse(Inverse(TINY), tmp_path / "before.safetensors", {"steps": 7})
    before, _ = read_inverse(tmp_path / "before.safetensors")
    state = legs(tmp_path / "run", 0, begin=tmp_path / "before.safetensors")
    assert state.step == 0 and state.about["origin"] == {"steps": 7}
    for a, b in zip(before.parameters(), state.average.parameters(), strict=True):
        assert torch.equal(a, b)


def test_what_is_shipped_is_the_running_average(tmp_path: Path) -> None:
    torch.manual_seed(3)
    begin, shipped = tmp_path / "before.safetensors", tmp_path / "shipped.safetensors"
    save_inverse(Inverse(), begin, {"steps": 7})
    state = legs(tmp_path / "run", 1, InverseConfig(), begin)
    assert ship(tmp_path / "run", shipped)["photographs_seen"] == 8
    for a, b in zip(state.average.parameters(), read_inverse(shipped)[0].parameters(), strict=True):
        assert torch.allclose(a, b, atol=1e-3)


def test_the_rate_warms_up_stays_and_falls_to_nothing() -> None:
    cooled = TrainSettings(steps=10_000, rate=1e-3, cooling=4_000)
    rates = [cooled.schedule.share(step) for step in (0, 199, 6_000, 8_000, 10_000, 10_001)]
    assert rates == pytest.approx([5e-3, 1.0, 1.0, 0.5, 0.0, 0.0])
    # A run without cooling knows nothing of its end.
    assert TrainSettings(steps=10_000).schedule.share(10_000) == 1.0


def test_a_few_steps_on_one_picture_lower_its_loss() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY)
    sample = draw_sample(1, 64, 64)
    inputs = sample.inputs[None]
    true = wanted([sample], np.random.default_rng(0))
    optimiser = torch.optim.SGD(network.parameters(), lr=0.02)
    losses = []
    for _ in range(12):
        loss = total(loss_parts(network(inputs), true))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
    assert min(losses[-3:]) < losses[0]


# What a network is judged by: the truth is without fault, and what is wrong is told.


@pytest.fixture(scope="module")
def sample() -> Sample:
    return draw_sample(10, 96, 64)


def test_the_truth_scores_as_the_truth(sample: Sample) -> None:
    truth = sample.residuals.stacked()
    sure = torch.where(sample.metal > 0.5, 20.0, -20.0)
    answer = torch.cat([truth, torch.zeros(ERRORS, *truth.shape[-2:]), sure])
    result = score(answer, sample, np.random.default_rng(0))
    assert result["correlation"] == pytest.approx(1.0, abs=1e-3)
    off = [result[name] for name in ("tilt_off", "contrast_off", "relit")]
    assert off == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)
    answer[5] *= 0.5  # height
    flatter = score(answer, sample, np.random.default_rng(0))
    assert flatter["tilt"] < -0.3
    assert flatter["relit"] > result["relit"]


def test_the_photograph_taken_for_albedo_is_no_good_guess(sample: Sample) -> None:
    albedo = photograph_as_albedo(sample)
    assert float(albedo.height.abs().max()) == 0.0
    assert relit_error(albedo, sample.truth, sample) > 0.03
    paler = replace(sample.truth, diffuse=sample.truth.diffuse.clamp(max=0.9))
    assert relit_error(paler, sample.truth, sample) < 0.03


def test_doubt_that_is_right_is_calibrated() -> None:
    generator = torch.Generator().manual_seed(0)
    expected = torch.rand(2, 40_000, generator=generator) + 0.1
    made = expected * torch.randn(2, 40_000, generator=generator).abs() / 0.6745
    assert torch.allclose(calibration(expected, made), torch.ones(2, 10), atol=0.08)
    assert float(calibration(expected, 3.0 * made).min()) > 2.4


def test_a_network_is_judged(sample: Sample) -> None:
    torch.manual_seed(0)
    judged = evaluate(Inverse(TINY).eval(), [sample])
    assert sum(name.startswith("doubt of") for name in judged) == ERRORS
    assert all(np.isfinite(value) for value in judged.values())
    assert "| correlation |" in table({"a network": judged})


def test_a_step_stays_on_its_device() -> None:
    """A device without memory, in place of CUDA, refuses operands that lie elsewhere."""
    sample, settings = draw_sample(2, 64, 64), TrainSettings(device="meta")
    training = start(TINY, settings)
    loss, parts = step_loss(training.model, 0, [(sample.inputs, sample)], settings)
    gradients = torch.autograd.grad(loss, list(training.model.parameters()))
    tensors = (loss, *parts.values(), *gradients, *training.average.parameters())
    assert {tensor.device.type for tensor in tensors} == {"meta"}
    with pytest.raises(RuntimeError, match="device"):
        loss + torch.ones(2)
