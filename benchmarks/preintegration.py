"""Preintegration of a full IMU: windows at once against a loop, and against pypose's integrator.

    python benchmarks/preintegration.py

Figures are millions of samples per CPU second of one thread, best of some repeats; ratios are to
the loop of the same run, which goes sample by sample over all windows at once and gives increments
alone. pypose 0.9.5, where it is installed, gives increments from the same samples without and
with their covariance; ours always gives increments, derivatives in the biases and covariance. The
last lines carry an error-free simulated drive over windows of one second, one after another,
beside the strapdown that goes over its samples.
"""

import argparse
import time
import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.attitude import (
    matrix_from_quaternion,
    quaternion_from_angles,
    quaternion_from_rotation_vector,
)
from navlearn.attitude import quaternion_multiply as times
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.preintegration import (
    Preintegrated,
    predict,
    preintegrate,
    preintegrate_increments,
)
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import ImuSample, InsState

GYRO, ACCEL = 1e-4, 1e-3
Run = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, ...]]


def samples(windows: int, n: int) -> tuple[Tensor, Tensor, Tensor]:
    t = torch.arange(windows * n, dtype=torch.float64).view(windows, n, 1) * 0.01
    axis = torch.arange(3, dtype=torch.float64)
    omega = 0.2 * torch.sin(0.07 * t + axis) + 0.02 * torch.cos(6.0 * t * (1.0 + axis))
    force = torch.cat((torch.sin(0.9 * t), 1.5 * torch.cos(0.3 * t), 9.8 + 0.0 * t), -1)
    return omega, force, torch.full((windows, n), 0.01, dtype=torch.float64)


def loop(omega: Tensor, force: Tensor, dt: Tensor) -> tuple[Tensor, ...]:
    q = torch.nn.functional.pad(torch.ones_like(dt[:, :1]), (0, 3))
    v = p = torch.zeros_like(omega[:, 0])
    for w, f, h in zip(omega.unbind(1), force.unbind(1), dt.unsqueeze(-1).unbind(1), strict=True):
        half = quaternion_from_rotation_vector(0.5 * w * h)
        q = times(q, half)
        added = (matrix_from_quaternion(q) @ (f * h).unsqueeze(-1)).squeeze(-1)
        p, v = p + (v + 0.5 * added) * h, v + added
        q = times(q, half)
    return q, v, p


def ours(omega: Tensor, force: Tensor, dt: Tensor) -> tuple[Tensor, ...]:
    return preintegrate(omega, force, dt, gyro_random_walk=GYRO, accel_random_walk=ACCEL)


def with_scale_factors(omega: Tensor, force: Tensor, dt: Tensor) -> tuple[Tensor, ...]:
    return preintegrate(
        omega, force, dt, gyro_random_walk=GYRO, accel_random_walk=ACCEL, scale_factors=True
    )


def peer(dtype: torch.dtype, covariance: bool) -> Run | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import pypose
    except ImportError:
        return None
    zero = torch.zeros(3, dtype=dtype)
    start = pypose.identity_SO3(dtype=dtype)
    integrator = pypose.module.IMUPreintegrator(
        zero,
        start,
        zero,
        gravity=0.0,
        gyro_cov=GYRO**2,
        acc_cov=ACCEL**2,
        prop_cov=covariance,
        reset=True,
    ).to(dtype)

    def run(omega: Tensor, force: Tensor, dt: Tensor) -> tuple[Tensor, ...]:
        found = integrator(dt=dt.to(dtype).unsqueeze(-1), gyro=omega.to(dtype), acc=force.to(dtype))
        last = [found[k][:, -1] for k in ("vel", "pos")]
        told = [found["cov"]] if covariance else []
        return found["rot"][:, -1].tensor(), *last, *told

    return run


def rate(run: Run, windows: int, n: int, repeats: int, backward: bool) -> float:
    omega, force, dt = samples(windows, n)
    best = float("inf")
    for _ in range(repeats):
        leaves = [x.detach().requires_grad_(backward) for x in (omega, force)]
        begin = time.process_time()
        with torch.set_grad_enabled(backward):
            found = run(leaves[0], leaves[1], dt)
            if backward:
                torch.stack([x.sum() for x in found if x.requires_grad]).sum().backward()
        best = min(best, time.process_time() - begin)
    return windows * n / best / 1e6


def print_rates(windows: list[int], n: int, repeats: int) -> None:
    ways: list[tuple[str, Run | None]] = [
        ("loop, increments alone", loop),
        ("pypose, float32", peer(torch.float32, False)),
        ("  with covariance", peer(torch.float32, True)),
        ("pypose, float64", peer(torch.float64, False)),
        ("  with covariance", peer(torch.float64, True)),
        ("ours, all, float64", ours),
        ("  with scale factors", with_scale_factors),
    ]
    columns = [(w, b) for w in windows for b in (False, True)]
    titles = (f"{'f+b' if b else 'fwd'} B={w}" for w, b in columns)
    print(f"{'M samples/s (ratio)':26}" + "".join(f"{t:>18}" for t in titles))
    base: list[float] = []
    for name, run in ways:
        if run is None:
            print(f"{name:26} not installed")
            continue
        found = [rate(run, w, n, repeats, b) for w, b in columns]
        base = base or found
        cells = (f"{r:10.3f} ({r / b:4.1f}x)" for r, b in zip(found, base, strict=True))
        print(f"{name:26}" + "".join(cells), flush=True)


def print_drive(seconds: int) -> None:
    log = simulate_drive(
        profile="mixed", grade="ideal", duration=float(seconds), seed=11, imu_rate_hz=100.0
    ).log
    imu = ImuSample(*(x.unsqueeze(0) for x in imu_timeline(log).samples))
    truth = torch.from_numpy(log.reference.to_numpy(dtype="float64", copy=True))
    names = {name: k for k, name in enumerate(log.reference.columns)}
    lat, lon, height, azimuth, pitch, roll = (
        truth[:1, names[n]] for n in ("lat", "lon", "height", "azimuth", "pitch", "roll")
    )
    q_lb = quaternion_from_angles(azimuth, pitch, roll)
    start = InsState(lat, lon, height, truth[:1, [names[n] for n in ("v_e", "v_n", "v_u")]], q_lb)
    count = imu.dt.shape[-1] // 100
    imu = ImuSample(*(x[:, : 100 * count] for x in imu))
    begin = time.process_time()
    path = strapdown_over_time(start, imu)
    took = time.process_time() - begin
    rotation, velocity = coning_sculling(imu.omega_ib_b, imu.f_b, imu.dt)
    begin = time.process_time()
    pre = preintegrate_increments(
        rotation.view(-1, 100, 3), velocity.view(-1, 100, 3), imu.dt.view(-1, 100)
    )
    sums = time.process_time() - begin
    state, step, level, high = start, torch.jit.script(predict), 0.0, 0.0
    begin = time.process_time()
    for k in range(count):
        state = step(state, Preintegrated(*(x[k : k + 1] for x in pre)))
        at = 100 * (k + 1) - 1
        north, east = state.lat - path.lat[:, at], state.lon - path.lon[:, at]
        level = max(level, 6.4e6 * float(torch.hypot(north, east)))
        high = max(high, float((state.height - path.height[:, at]).abs()))
    carried = time.process_time() - begin
    print(
        f"{count} windows of 1 s one after another, from the strapdown over {100 * count} samples: "
        f"{1e3 * level:.3f} mm level, {1e3 * high:.3f} mm high at most\n"
        f"CPU s: strapdown {took:.3f}, sums {sums:.3f}, predictions {carried:.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, nargs="+", default=[256])
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seconds", type=int, default=3600)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print_rates(options.windows, options.samples, options.repeats)
    with torch.no_grad():
        print_drive(options.seconds)


if __name__ == "__main__":
    main()
