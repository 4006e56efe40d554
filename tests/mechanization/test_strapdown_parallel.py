"""The parallel strapdown: equal to the sequential one, its gradient equal to autograd's tape."""

import pytest
import torch

from navlearn.errors import ShapeError
from navlearn.mechanization import strapdown_chunks
from navlearn.mechanization.strapdown import local_level_in_turn, strapdown_in_turn
from navlearn.mechanization.strapdown_parallel import local_level_over_time, strapdown_over_time
from navlearn.states import ImuSample, InsState

METRES = (6.4e6, 6.4e6, 1.0, 1.0, 1.0)


def _largest(found, expected) -> float:
    return max(
        float((a - b).abs().max()) * metres
        for a, b, metres in zip(found, expected, METRES, strict=True)
    )


def _sensor_errors(records: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    names = ("gyro_bias", "accel_bias", "gyro_scale", "accel_scale")
    sizes = (1e-3, 0.05, 3e-3, 2e-3)
    return {
        name: size * torch.randn(records, 3, generator=generator, dtype=torch.float64)
        for name, size in zip(names, sizes, strict=True)
    }


@pytest.fixture
def small_chunks(monkeypatch):
    """Cut time and records so finely that short records cross chunks."""
    monkeypatch.setattr(strapdown_chunks, "CHUNK_ELEMENTS", 90)


@pytest.mark.parametrize("gradient", ["recompute", "tape"])
@pytest.mark.parametrize("dt", [0.01, 0.2])
def test_equals_the_sequential_form(imu_drive, ins_start, small_chunks, gradient, dt):
    samples, begin, errors = imu_drive(2, 500, dt), ins_start(2), _sensor_errors(2)
    stretched = samples.dt * torch.linspace(0.5, 1.5, 500, dtype=torch.float64)
    stretched[1, 200:210] = 0.0
    samples = samples._replace(dt=stretched)
    with torch.no_grad():
        found = strapdown_over_time(begin, samples, **errors, gradient=gradient)
        expected = strapdown_in_turn(begin, samples, **errors)
    assert _largest(found, expected) < 1e-6 * (1.0 + (dt > 0.1))


@pytest.mark.slow
def test_equals_the_sequential_form_over_an_hour_at_100_hz(imu_drive, ins_start):
    samples, begin = imu_drive(1, 360_000), ins_start(1)
    with torch.no_grad():
        found = strapdown_over_time(begin, samples)
        expected = strapdown_in_turn(begin, samples)
    assert _largest(found, expected) < 1e-4


def test_chunks_of_any_length_give_the_same(imu_drive, ins_start, monkeypatch):
    samples, begin = imu_drive(2, 9000), ins_start(2)
    found = []
    for elements in (400, 3000, 40_000):
        monkeypatch.setattr(strapdown_chunks, "CHUNK_ELEMENTS", elements)
        found.append(strapdown_over_time(begin, samples))
    assert _largest(found[0], found[1]) < 1e-7
    assert _largest(found[0], found[2]) < 1e-7


def test_batches_equal_single_records_and_extra_batch_axes_keep_their_shape(imu_drive, ins_start):
    samples, begin, errors = imu_drive(6, 120), ins_start(6), _sensor_errors(6)
    together = strapdown_over_time(begin, samples, **errors)
    folded = strapdown_over_time(
        InsState(*(x.reshape(2, 3, *x.shape[1:]) for x in begin)),
        ImuSample(*(x.reshape(2, 3, *x.shape[1:]) for x in samples)),
        **{name: x.reshape(2, 3, 3) for name, x in errors.items()},
    )
    for j in range(6):
        one = strapdown_over_time(
            InsState(*(x[j] for x in begin)),
            ImuSample(*(x[j] for x in samples)),
            **{name: x[j] for name, x in errors.items()},
        )
        assert one.q_lb.shape == (120, 4)
        assert _largest(one, [x[j] for x in together]) < 1e-8
        assert _largest(one, [x[j // 3, j % 3] for x in folded]) < 1e-8


def test_a_block_goes_on_where_the_one_before_ended(imu_drive, ins_start):
    samples, begin = imu_drive(2, 400), ins_start(2)
    dt = samples.dt.unsqueeze(-1)
    turn, push = samples.omega_ib_b * dt, samples.f_b * dt
    whole = local_level_over_time(begin, turn, push, samples.dt)
    middle = InsState(*(x[:, 199] for x in whole))
    later = local_level_over_time(middle, turn[:, 200:], push[:, 200:], samples.dt[:, 200:])
    assert _largest(later, [x[:, 200:] for x in whole]) < 1e-8


def test_padding_moves_nothing_and_takes_no_gradient(imu_drive, ins_start, small_chunks):
    samples, begin = imu_drive(2, 300), ins_start(2)
    dt = samples.dt.clone()
    dt[1, 170:] = 0.0
    force = samples.f_b.clone().requires_grad_()
    found = strapdown_over_time(begin, samples._replace(dt=dt, f_b=force))
    for channel in found:
        held = channel[1, 169:170].expand_as(channel[1, 170:])
        torch.testing.assert_close(channel[1, 170:], held, rtol=0, atol=3e-9)
    (6.4e6 * (found.lat + found.lon)[:, -1]).sum().backward()
    assert force.grad[1, 170:].abs().max() == 0.0
    assert force.grad[1, :170].abs().amax(-1).min() > 0.0


def test_an_empty_record_gives_an_empty_solution(imu_drive, ins_start):
    found = strapdown_over_time(ins_start(2), imu_drive(2, 0))
    assert [x.shape for x in found] == [(2, 0), (2, 0), (2, 0), (2, 0, 3), (2, 0, 4)]


def _flat(run, gradient):
    """Return a run as a function of tensors, its outputs in metres and radians."""

    def function(lat, lon, height, v_l, q_lb, *increments):
        start = InsState(lat, lon, height, v_l, q_lb)
        how = () if gradient is None else (gradient,)
        found = run(start, *increments, *how)
        return tuple(x * metres for x, metres in zip(found, METRES, strict=True))

    return function


RECOMPUTE = _flat(local_level_over_time, "recompute")
TAPE = _flat(local_level_over_time, "tape")
LOOP = _flat(local_level_in_turn, None)


def _inputs(imu_drive, ins_start, records, length, dt) -> tuple[torch.Tensor, ...]:
    samples = imu_drive(records, length, dt)
    h = samples.dt.unsqueeze(-1)
    inputs = (*ins_start(records), samples.omega_ib_b * h, samples.f_b * h, samples.dt)
    return tuple(x.clone().requires_grad_() for x in inputs)


def _gradients(function, inputs) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(1)
    loss = sum(
        (x * torch.randn(x.shape, generator=generator, dtype=x.dtype)).sum()
        for x in function(*inputs)
    )
    return torch.autograd.grad(loss, inputs)


def test_recomputing_passes_gradcheck(imu_drive, ins_start):
    unit = 1e3 / 6.4e6

    def scaled(lat, lon, *others):
        found = RECOMPUTE(lat * unit, lon * unit, *others)
        return tuple(x / 1e3 for x in found[:3]) + found[3:]

    inputs = _inputs(imu_drive, ins_start, 2, 5, 0.5)
    inputs = tuple(
        (x.detach() / unit).requires_grad_() if k < 2 else x for k, x in enumerate(inputs)
    )
    assert torch.autograd.gradcheck(scaled, inputs, eps=1e-5, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("dt", [0.01, 0.3])
def test_gradients_equal_those_of_the_tape_and_of_the_loop(imu_drive, ins_start, small_chunks, dt):
    inputs = _inputs(imu_drive, ins_start, 3, 200, dt)
    found = _gradients(RECOMPUTE, inputs)
    for other, bound in ((TAPE, 1e-11), (LOOP, 1e-7)):
        for a, b in zip(found, _gradients(other, inputs), strict=True):
            assert float((a - b).abs().max()) < bound * float(b.abs().max())


def test_vmap_jacobians_and_per_record_gradients(imu_drive, ins_start, small_chunks):
    inputs = tuple(x.detach() for x in _inputs(imu_drive, ins_start, 3, 90, 0.1))
    for a, b in zip(torch.func.vmap(RECOMPUTE)(*inputs), RECOMPUTE(*inputs), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-8)
    one = tuple(x[0] for x in inputs)
    per_record, jacobians = [], []
    for run in (RECOMPUTE, TAPE):

        def end(turn, push, run=run):
            return run(*one[:5], turn, push, one[7])[0][-1]

        def speeds(v_l, run=run):
            return run(*one[:3], v_l, *one[4:])[3][::30]

        per_record.append(
            torch.func.vmap(torch.func.grad(end, argnums=(0, 1)))(inputs[5], inputs[6])
        )
        jacobians.append(torch.func.jacrev(speeds)(one[3]))
    for a, b in zip(*per_record, strict=True):
        assert a.shape == (3, 90, 3)
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(*jacobians, rtol=1e-9, atol=1e-9)


def test_second_derivatives_and_forward_mode_are_the_tapes(imu_drive, ins_start):
    inputs = tuple(x.detach() for x in _inputs(imu_drive, ins_start, 1, 8, 0.5))

    def end(run):
        return lambda push: run(*inputs[:6], push, inputs[7])[0][0, -1] ** 2 * 1e-12

    push = inputs[6].clone().requires_grad_()
    (first,) = torch.autograd.grad(end(RECOMPUTE)(push), push, create_graph=True)
    with pytest.raises(NotImplementedError, match="gradient='tape'"):
        torch.autograd.grad(first.sum(), push)
    (first,) = torch.autograd.grad(end(TAPE)(push), push, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), push)
    assert second.abs().max() > 0
    tangent = torch.ones_like(inputs[6])
    _, slope = torch.func.jvp(end(TAPE), (inputs[6],), (tangent,))
    torch.testing.assert_close(slope, first.sum().detach(), rtol=1e-9, atol=0)
    with pytest.raises(RuntimeError, match="jvp"):
        torch.func.jvp(end(RECOMPUTE), (inputs[6],), (tangent,))


def test_a_long_record_keeps_little_for_its_backward_pass(imu_drive, ins_start):
    length = 60_000
    bias = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    kept: dict[int, int] = {}

    def keep(x: torch.Tensor) -> torch.Tensor:
        kept[x.untyped_storage().data_ptr()] = x.untyped_storage().nbytes()
        return x

    samples, begin = imu_drive(1, length), ins_start(1)
    with torch.autograd.graph.saved_tensors_hooks(keep, lambda x: x):
        dt = samples.dt.unsqueeze(-1)
        turn, push = (samples.omega_ib_b - bias.unsqueeze(1)) * dt, samples.f_b * dt
        found = local_level_over_time(begin, turn, push, samples.dt)
    found.lat[0, -1].backward()
    assert bias.grad.abs().max() > 0
    assert sum(kept.values()) < 60 * 8 * length


def test_increments_that_do_not_go_together_are_refused(imu_drive, ins_start):
    samples = imu_drive(2, 5)
    with pytest.raises(ShapeError, match="put x, y, z last"):
        local_level_over_time(ins_start(2), samples.omega_ib_b, samples.f_b[:, :4], samples.dt)
