"""Strapdown of a full IMU: loops against the parallel form, drift against the truth.

    python benchmarks/strapdown.py

Figures are millions of samples per CPU second of one thread, best of some repeats, and ratios to
the Python loop of the same run; loops run on fewer samples, their cost being the same for each.
One hour at 100 Hz is one record (B = 1), 32 records, or 3600 blocks of a second. Backward is the
gradient of the end in a gyro and an accelerometer bias per record. Drift is the largest distance
from the truth of a simulated drive with error-free sensors; the last table is the largest
difference between the parallel form and the loop (an hour: --compare-minutes 60).
"""

import argparse
import time
import warnings
from collections.abc import Callable

import torch

from navlearn import attitude
from navlearn.logs.synthetic import simulate_drive
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.strapdown import local_level_in_turn, strapdown_in_turn
from navlearn.mechanization.strapdown_ecef import from_ecef, strapdown_ecef_in_turn, to_ecef
from navlearn.mechanization.strapdown_parallel import local_level_over_time, strapdown_over_time
from navlearn.states import ImuSample, InsState

RATE = 100
Run = Callable[[InsState, torch.Tensor, torch.Tensor, torch.Tensor], InsState]


def drive(minutes: float) -> tuple[InsState, ImuSample, InsState]:
    """Return start, error-free samples and truth of a simulated drive."""
    log = simulate_drive(
        grade="ideal",
        duration=60.0 * minutes,
        seed=11,
        imu_rate_hz=RATE,
        reference_rate_hz=RATE,
        standstill=min(30.0, 20.0 * minutes),
    ).log

    def read(table, *columns: str) -> torch.Tensor:
        return torch.tensor(table[list(columns)].to_numpy(), dtype=torch.float64)

    omega, force = (read(log.imu, *(f"{n}_{a}" for a in "xyz")) for n in ("gyro", "accel"))
    zero = torch.zeros(len(omega), dtype=torch.float64)
    angles = read(log.reference, "azimuth", "pitch", "roll")
    truth = InsState(
        *read(log.reference, "lat", "lon", "height").unbind(-1),
        read(log.reference, "v_e", "v_n", "v_u"),
        attitude.quaternion_from_angles(*angles.unbind(-1)),
    )
    samples = ImuSample(zero + 1.0 / RATE, omega, force, zero, zero, zero)
    return InsState(*(x[0] for x in truth)), samples, InsState(*(x[1:] for x in truth))


def records(
    start: InsState, samples: ImuSample, count: int, length: int
) -> tuple[InsState, ImuSample]:
    """Return a drive repeated and cut into records, all from the same start."""
    times = -(-count * length // len(samples.dt))
    cut = [
        torch.cat([x] * times)[: count * length].reshape(count, length, *x.shape[1:])
        for x in samples
    ]
    return InsState(*(x.expand(count, *x.shape) for x in start)), ImuSample(*cut)


def forward(run: Run, start: InsState, samples: ImuSample) -> None:
    with torch.no_grad():
        run(start, *coning_sculling(samples.omega_ib_b, samples.f_b, samples.dt), samples.dt)


def forward_backward(run: Run, start: InsState, samples: ImuSample) -> None:
    gyro, accel = (torch.zeros_like(start.v_l, requires_grad=True) for _ in range(2))
    omega, force = samples.omega_ib_b - gyro.unsqueeze(1), samples.f_b - accel.unsqueeze(1)
    found = run(start, *coning_sculling(omega, force, samples.dt), samples.dt)
    end = 6.4e6 * (found.lat[:, -1] + found.lon[:, -1]).sum() + found.v_l[:, -1].sum()
    end.backward()


def rate(
    work: Callable[..., None], run: Run, made: tuple[InsState, ImuSample], repeats: int
) -> float:
    best = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        work(run, *made)
        best = min(best, time.process_time() - begin)
    return made[1].dt.numel() / best / 1e6


def print_rates(start: InsState, samples: ImuSample, few: int, whole: int, repeats: int) -> None:
    ways: list[tuple[str, Run, bool]] = [
        ("Python loop", local_level_in_turn, True),
        ("TorchScript loop", torch.jit.script(local_level_in_turn), True),
        ("parallel", local_level_over_time, False),
    ]
    counts = (1, 32, max(whole // 100, 1))
    titles = [f"{name} B={b}" for name in ("fwd", "f+b") for b in counts]
    print(f"{'M samples/s (ratio)':20}" + "".join(f"{title:>22}" for title in titles))
    base: list[float] = []
    for name, run, slow in ways:
        found = []
        for work in (forward, forward_backward):
            for b in counts:
                length = min(few, max(whole // b, 1)) if slow else max(whole // b, 1)
                made = records(start, samples, b, length)
                found.append(rate(work, run, made, min(repeats, 2) if slow else repeats))
        base = base or found
        cells = (f"{r:13.4f} ({r / b:5.0f}x)" for r, b in zip(found, base, strict=True))
        print(f"{name:20}" + "".join(cells), flush=True)


def difference(found: InsState, expected: InsState) -> str:
    radius = 6.38e6
    position = torch.stack(
        (
            radius * (found.lat - expected.lat),
            radius * (found.lon - expected.lon) * torch.cos(expected.lat),
            found.height - expected.height,
        )
    )
    sign = torch.sign((found.q_lb * expected.q_lb).sum(-1, keepdim=True))
    turn = 2.0 * (found.q_lb - sign * expected.q_lb).norm(dim=-1)
    speed = (found.v_l - expected.v_l).norm(dim=-1)
    return (
        f"{float(position.norm(dim=0).max()):12.2e} m {float(speed.max()):12.2e} m/s "
        f"{float(turn.max()):12.2e} rad"
    )


def print_drift(minutes: float) -> None:
    start, samples, truth = drive(minutes)
    dt = samples.dt.unsqueeze(-1)
    with torch.no_grad():
        plain = local_level_over_time(start, samples.omega_ib_b * dt, samples.f_b * dt, samples.dt)
        parallel = strapdown_over_time(start, samples)
        level = strapdown_in_turn(start, samples)
        ecef = from_ecef(strapdown_ecef_in_turn(to_ecef(start), samples))
    print(f"\nerror-free sensors, {minutes:g} min at {RATE} Hz: largest difference")
    print("local level in turn - truth    ", difference(level, truth))
    print("parallel - truth               ", difference(parallel, truth))
    print("Earth-centred in turn - truth  ", difference(ecef, truth))
    print("Earth-centred - local level    ", difference(ecef, level))
    print("parallel, no coning - truth    ", difference(plain, truth))


def print_comparison(minutes: float) -> None:
    start, samples, _ = drive(minutes)
    with torch.no_grad():
        found = strapdown_over_time(start, samples)
        expected = strapdown_in_turn(start, samples)
    print(f"\nparallel - local level in turn, {minutes:g} min: {difference(found, expected)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--samples", type=int, default=3600 * RATE)
    parser.add_argument("--loop-samples", type=int, default=300)
    parser.add_argument("--drift-minutes", type=float, default=10.0)
    parser.add_argument("--compare-minutes", type=float, default=2.0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    start, samples, _ = drive(min(10.0, max(arguments.samples / RATE / 60.0, 0.2)))
    print_rates(start, samples, arguments.loop_samples, arguments.samples, arguments.repeats)
    if arguments.drift_minutes > 0.0:
        print_drift(arguments.drift_minutes)
    if arguments.compare_minutes > 0.0:
        print_comparison(arguments.compare_minutes)


if __name__ == "__main__":
    main()
