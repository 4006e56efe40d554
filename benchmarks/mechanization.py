"""RISS mechanization: the loops against the parallel form, forward and backward.

    python benchmarks/mechanization.py

Figures are millions of samples per CPU second of one thread, best of some repeats, and ratios to
the Python loop of the same run; loops run on fewer samples, their cost being the same for each.
Peak memory is what a fresh process grows by while it mechanizes 80 minutes at 100 Hz.
"""

import argparse
import multiprocessing
import resource
import time
from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.mechanization import RissMechanization, RissOptions, riss_over_time
from navlearn.states import NavState, RissSample, Trajectory

RATE = 100


def drive(records: int, length: int) -> tuple[NavState, RissSample]:
    t = torch.arange(length, dtype=torch.float64) / RATE
    phase = torch.arange(records, dtype=torch.float64).unsqueeze(-1)
    zero = torch.zeros(records, length, dtype=torch.float64)
    samples = RissSample(
        dt=zero + 1.0 / RATE,
        yaw_rate=0.15 * torch.sin(0.157 * t + phase),
        speed=15.0 + 12.0 * torch.sin(0.065 * t + phase),
        pitch=0.06 * torch.sin(t / 30.0 + phase),
        roll=0.04 * torch.cos(t / 11.0 + phase),
        f_x=zero,
        f_y=zero,
        stationary=zero,
    )
    start = NavState(*(torch.full((records,), x, dtype=torch.float64) for x in (0.77, -1.3, 80, 1)))
    return start, samples


def forward(run: Callable[..., Trajectory], start: NavState, samples: RissSample) -> None:
    zero = torch.zeros((), dtype=torch.float64)
    with torch.no_grad():
        run(start, samples, zero, zero, zero)


def forward_backward(run: Callable[..., Trajectory], start: NavState, samples: RissSample) -> None:
    """Differentiate in a bias per sample, an odometer scale and a pitch bias per record."""
    bias = torch.zeros_like(samples.dt, requires_grad=True)
    scale, pitch = (torch.zeros_like(start.lat, requires_grad=True) for _ in range(2))
    found = run(start, samples, bias, scale, pitch)
    loss: Tensor = 6.4e6 * (found.lat[..., -1] + found.lon[..., -1]).sum() + found.v_e.sum()
    loss.backward()


def rate(
    work: Callable[..., None],
    run: Callable[..., Trajectory],
    records: int,
    length: int,
    repeats: int,
) -> float:
    start, samples = drive(records, length)
    best = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        work(run, start, samples)
        best = min(best, time.process_time() - begin)
    return records * length / best / 1e6


def _grown(queue: "multiprocessing.Queue[float]", gradient: str, backward: bool) -> None:
    torch.set_num_threads(1)
    start, samples = drive(1, 80 * 60 * RATE)
    options = RissOptions(gradient=gradient)  # type: ignore[arg-type]
    work = forward_backward if backward else forward
    short = RissSample(*(x[:, :1000] for x in samples))
    work(
        lambda *a: riss_over_time(*a, options=options), start, short
    )  # loads what torch loads late
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    work(lambda *a: riss_over_time(*a, options=options), start, samples)
    queue.put((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)


def peak_memory(gradient: str, backward: bool) -> float:
    context = multiprocessing.get_context("spawn")
    queue: multiprocessing.Queue[float] = context.Queue()
    process = context.Process(target=_grown, args=(queue, gradient, backward))
    process.start()
    grown = queue.get()
    process.join()
    return grown


def print_rates(few: int, repeats: int) -> None:
    loop, (hour, minute) = RissMechanization(), (3600 * RATE, 60 * RATE)
    flat, tape = RissOptions(dimensions=2), RissOptions(gradient="tape")
    ways: list[tuple[str, Callable[..., Trajectory], int, int, int]] = [
        ("Python loop", loop, few, few // 4, 2),
        ("TorchScript loop", torch.jit.script(loop), few, few // 4, 2),
        ("parallel 3D", riss_over_time, hour, minute, repeats),
        ("parallel 2D", lambda *a: riss_over_time(*a, options=flat), hour, minute, repeats),
        ("parallel 3D, tape", lambda *a: riss_over_time(*a, options=tape), hour, minute, repeats),
    ]
    titles = ("fwd B=1", "fwd B=256", "f+b B=1", "f+b B=256")
    print(f"{'M samples/s (ratio)':20}" + "".join(f"{title:>20}" for title in titles))
    base: list[float] = []
    for name, run, single, many, times in ways:
        found = [
            rate(work, run, records, length, times)
            for work in (forward, forward_backward)
            for records, length in ((1, single), (256, many))
        ]
        base = base or found
        cells = (f"{r:12.4f} ({r / b:4.0f}x)" for r, b in zip(found, base, strict=True))
        print(f"{name:20}" + "".join(cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--loop-samples", type=int, default=2000)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    # memory first: a child process starts with the peak of its parent
    print(
        "peak memory, 80 min at 100 Hz, MB: "
        f"forward {peak_memory('adjoint', False):.0f}, "
        f"forward+backward {peak_memory('adjoint', True):.0f}, "
        f"by tape {peak_memory('tape', True):.0f}"
    )
    print_rates(arguments.loop_samples, arguments.repeats)


if __name__ == "__main__":
    main()
