"""The parallel RISS: equal to the sequential one, its adjoint equal to autograd's tape."""

import pytest
import torch

from navlearn.errors import ShapeError
from navlearn.mechanization import RissMechanization, RissOptions, riss_adjoint, riss_over_time
from navlearn.states import NavState, RissSample

ZERO = torch.zeros((), dtype=torch.float64)
METRES = (6.4e6, 4.5e6, 1.0, 1.0, 1.0, 1.0, 1.0)


def _sensor_errors(records: int, length: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(3)
    walk = torch.randn(records, length, generator=generator, dtype=torch.float64).cumsum(-1)
    scale = torch.linspace(-0.02, 0.03, records, dtype=torch.float64)
    return 1e-3 + 1e-5 * walk, scale, 0.3 * scale


def _largest(found, expected) -> list[float]:
    return [
        float((a - b).abs().max()) * metres
        for a, b, metres in zip(found, expected, METRES, strict=True)
    ]


@pytest.fixture
def small_chunks(monkeypatch):
    """Cut time so finely that short records cross chunks."""
    monkeypatch.setattr(riss_adjoint, "CHUNK_ELEMENTS", 150)


@pytest.mark.parametrize(
    "options",
    [
        RissOptions(),
        RissOptions(gradient="tape"),
        RissOptions(dimensions=2),
        RissOptions(tilt_compensation=False, earth_rate=False),
    ],
    ids=["3d", "tape", "2d", "ground rate"],
)
@pytest.mark.parametrize("dt", [0.01, 1.0])
def test_equals_the_sequential_form(drive, start, small_chunks, options, dt):
    samples, begin = drive(2, 1000, dt), start(2)
    errors = _sensor_errors(2, 1000)
    found = riss_over_time(begin, samples, *errors, options=options)
    expected = torch.jit.script(RissMechanization(options))(begin, samples, *errors)
    assert max(_largest(found, expected)) < 1e-6


@pytest.mark.slow
def test_equals_the_sequential_form_over_an_hour_at_100_hz(drive, start):
    samples, begin = drive(1, 360_000), start(1)
    found = riss_over_time(begin, samples)
    with torch.no_grad():
        expected = torch.jit.script(RissMechanization())(begin, samples, ZERO, ZERO, ZERO)
    assert max(_largest(found, expected)) < 1e-6


def test_batches_equal_single_records_and_extra_batch_axes_keep_their_shape(drive, start):
    samples, begin = drive(6, 300, 0.1), start(6)
    errors = _sensor_errors(6, 300)
    together = riss_over_time(begin, samples, *errors)
    folded = riss_over_time(
        NavState(*(x.reshape(2, 3) for x in begin)),
        RissSample(*(x.reshape(2, 3, 300) for x in samples)),
        *(e.reshape(2, 3, *e.shape[1:]) for e in errors),
    )
    for j in range(6):
        one = riss_over_time(
            NavState(*(x[j] for x in begin)),
            RissSample(*(x[j] for x in samples)),
            *(e[j] for e in errors),
        )
        assert one.lat.shape == (300,)
        assert max(_largest(one, [x[j] for x in together])) < 1e-8
        assert max(_largest(one, [x[j // 3, j % 3] for x in folded])) < 1e-8


def test_padding_moves_nothing_and_takes_no_gradient(drive, start, small_chunks):
    samples, begin = drive(2, 400, 0.1), start(2)
    dt = samples.dt.clone()
    dt[1, 250:] = 0.0
    speed = samples.speed.clone().requires_grad_()
    yaw_rate = samples.yaw_rate.clone().requires_grad_()
    found = riss_over_time(begin, samples._replace(dt=dt, speed=speed, yaw_rate=yaw_rate))
    for channel in found[:4]:
        assert torch.equal(channel[1, 250:], channel[1, 249:250].expand(150))
    (6.4e6 * (found.lat + found.lon)[:, -1]).sum().backward()
    for gradient in (speed.grad, yaw_rate.grad):
        assert gradient[1, 250:].abs().max() == 0.0
        assert gradient[1, :250].abs().min() > 0.0


def test_too_few_passes_show(drive, start):
    samples, begin = drive(1, 5000, 0.1), start(1)
    whole = riss_over_time(begin, samples)
    short = riss_over_time(begin, samples, options=RissOptions(passes=1))
    assert max(_largest(short, whole)) > 1e-3


def test_an_empty_record_gives_an_empty_trajectory(drive, start):
    assert riss_over_time(start(2), drive(2, 0)).lat.shape == (2, 0)


def _flat(options: RissOptions):
    """Return the mechanization as a function of tensors, outputs in metres and radians."""

    def function(lat, lon, height, azimuth, dt, yaw_rate, speed, pitch, roll, *errors):
        zero = torch.zeros_like(dt)
        samples = RissSample(dt, yaw_rate, speed, pitch, roll, zero, zero, zero)
        begin = NavState(lat, lon, height, azimuth)
        found = riss_over_time(begin, samples, *errors, options=options)
        return tuple(x * metres for x, metres in zip(found, METRES, strict=True))

    return function


def _inputs(drive, start, records: int, length: int, dt: float) -> tuple[torch.Tensor, ...]:
    inputs = (*start(records), *drive(records, length, dt)[:5], *_sensor_errors(records, length))
    return tuple(x.clone().requires_grad_() for x in inputs)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_adjoint_passes_gradcheck(drive, start, dimensions):
    inputs = _inputs(drive, start, 2, 6, 1.0)
    # latitude in units of a kilometre, so that a finite step is neither coarse nor drowned
    unit = 1e3 / 6.4e6

    def scaled(lat, lon, *others):
        found = _flat(RissOptions(dimensions=dimensions))(lat * unit, lon * unit, *others)
        return tuple(x / 1e3 for x in found)

    scaled_inputs = tuple(
        (x.detach() / unit).requires_grad_() if k < 2 else x for k, x in enumerate(inputs)
    )
    assert torch.autograd.gradcheck(scaled, scaled_inputs, eps=1e-5, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("earth_rate", [True, False])
@pytest.mark.parametrize("dt", [0.01, 2.0])
def test_adjoint_equals_the_tape(drive, start, small_chunks, dimensions, earth_rate, dt):
    inputs = _inputs(drive, start, 2, 500, dt)
    gradients = []
    for gradient in ("adjoint", "tape"):
        options = RissOptions(dimensions=dimensions, earth_rate=earth_rate, gradient=gradient)
        generator = torch.Generator().manual_seed(1)
        outputs = _flat(options)(*inputs)
        loss = sum(
            (x * torch.randn(x.shape, generator=generator, dtype=x.dtype)).sum() for x in outputs
        )
        gradients.append(
            torch.autograd.grad(loss, inputs, allow_unused=True, materialize_grads=True)
        )
    for by_adjoint, by_tape in zip(*gradients, strict=True):
        scale = float(by_tape.abs().max()) or 1.0
        assert float((by_adjoint - by_tape).abs().max()) / scale < 1e-9


def test_vmap_and_per_record_gradients(drive, start):
    inputs = tuple(x.detach() for x in _inputs(drive, start, 3, 50, 0.5))
    adjoint, tape = _flat(RissOptions()), _flat(RissOptions(gradient="tape"))
    mapped = torch.func.vmap(adjoint)(*inputs)
    for a, b in zip(mapped, adjoint(*inputs), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-7)

    def end(function):
        return lambda speed, bias: function(*one[:6], speed, *one[7:9], bias, *one[10:])[0][-1]

    one = tuple(x[0] for x in inputs)
    speeds, bias = torch.stack([inputs[6][0] + k for k in range(4)]), one[9]
    per_drive = [
        torch.func.vmap(torch.func.grad(end(f), argnums=(0, 1)), in_dims=(0, None))(speeds, bias)
        for f in (adjoint, tape)
    ]
    for a, b in zip(*per_drive, strict=True):
        assert a.shape == (4, 50)
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)
    jacobians = [
        torch.func.jacrev(lambda s, f=f: f(*one[:6], s, *one[7:])[1])(one[6])
        for f in (adjoint, tape)
    ]
    torch.testing.assert_close(*jacobians, rtol=1e-9, atol=1e-9)


def test_forward_mode_and_second_derivatives_refuse_and_the_tape_supports_them(drive, start):
    inputs = tuple(x.detach() for x in _inputs(drive, start, 1, 20, 0.5))

    def end(gradient):
        function = _flat(RissOptions(gradient=gradient))
        return lambda bias: function(*inputs[:9], bias, *inputs[10:])[0][0, -1]

    tangent = torch.ones_like(inputs[9])
    with pytest.raises(RuntimeError, match="jvp"):
        torch.func.jvp(end("adjoint"), (inputs[9],), (tangent,))
    _, slope = torch.func.jvp(end("tape"), (inputs[9],), (tangent,))
    gradient = torch.func.grad(end("adjoint"))(inputs[9])
    torch.testing.assert_close(slope, (gradient * tangent).sum(), rtol=1e-9, atol=0)

    bias = inputs[9].clone().requires_grad_()
    (first,) = torch.autograd.grad(end("adjoint")(bias), bias, create_graph=True)
    with pytest.raises(NotImplementedError, match="gradient='tape'"):
        torch.autograd.grad(first.sum(), bias)
    (first,) = torch.autograd.grad(end("tape")(bias), bias, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), bias)
    assert second.abs().max() > 0


def test_a_long_drive_keeps_little_for_its_backward_pass(drive, start):
    length = 480_000  # 80 minutes at 100 Hz
    samples = drive(1, length)
    bias = torch.zeros(1, length, dtype=torch.float64, requires_grad=True)
    scale = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    kept: dict[int, int] = {}

    def keep(x: torch.Tensor) -> torch.Tensor:
        kept[x.untyped_storage().data_ptr()] = x.untyped_storage().nbytes()
        return x

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda x: x):
        found = riss_over_time(start(1), samples, bias, scale)
    found.lat[0, -1].backward()
    assert bias.grad.abs().max() > 0
    assert sum(kept.values()) < 30 * 8 * length


def test_wrong_starts_are_refused_with_advice(drive, start):
    with pytest.raises(ShapeError, match=r"start.lat has shape \(3,\).*one start per record"):
        riss_over_time(start(3), drive(2, 5))
    with pytest.raises(ShapeError, match=r"float32.*\.double\(\)"):
        riss_over_time(NavState(*(x.float() for x in start(2))), drive(2, 5))
