"""Speed of the three forms of the loosely coupled filter, forward and backward.

    python benchmarks/ekf.py                    # an hour and 80 minutes at 100 Hz, batches of 32
    python benchmarks/ekf.py --minutes 5        # quick

CPU seconds of one thread; ratios are to the exact form in the same run. The sequential form runs
on a shorter stretch, the backward pass of the exact form too.
"""

import argparse
import math
import resource
import time

import torch

from navlearn.frames import shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import FixTiming, GnssFix, NavState, RissSample

RATE = 100


def drive(seconds: int, batch: int):
    """Return start, samples, fixes and timing of a made-up city drive."""
    g = torch.Generator().manual_seed(0)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    t = torch.arange(1, seconds * RATE + 1, dtype=torch.float64) / RATE
    zero = torch.zeros(batch, len(t), dtype=torch.float64)
    phase = 6.28 * torch.rand(batch, 1, generator=g, dtype=torch.float64)
    speed = torch.where(t % 90 > 75, zero, 12.0 + 8.0 * torch.sin(0.13 * t + phase))
    turning = 0.15 * torch.sin(0.2 * t + phase) + 0.05 * torch.sin(0.9 * t)
    pitch = 0.03 * torch.sin(0.12 * t + phase)
    lat = torch.full((batch,), 0.77, dtype=torch.float64)
    start = NavState(lat, -1.33 + 0.0 * lat, 100.0 + 0.0 * lat, 0.5 + 0.0 * lat)
    turning = torch.where(speed > 0, turning, 0.0) + 7.292115e-5 * math.sin(0.77)
    still = (speed == 0).to(zero)
    clean = RissSample(zero + 1.0 / RATE, turning, speed, pitch, 0.0 * zero, zero, zero, still)
    truth = riss_over_time(start, clean)
    noisy = turning + 5e-4 + 2e-3 * normal(*zero.shape)
    samples = clean._replace(yaw_rate=noisy, speed=1.02 * speed, pitch=pitch + 0.01)
    index = torch.arange(RATE - 1, len(t), RATE).expand(batch, -1).contiguous()
    at = [torch.gather(x.expand(batch, -1), 1, index) for x in truth]
    shape = index.shape
    lat, lon, height = shift_geodetic(*at[:3], *(1.5 * normal(*shape) for _ in range(3)))
    one = torch.ones(shape, dtype=torch.float64)
    v = [x + 0.1 * normal(*shape) for x in at[4:]]
    sigma = 1.5 * one
    fixes = GnssFix(lat, lon, height, *v, sigma, sigma, sigma, 0.1 * one, one, one)
    return start, samples, fixes, FixTiming(index, 0.0 * one)


def timed(ekf, inputs, method, backward):
    """Return CPU seconds and history of one run."""
    start, samples, fixes, timing = inputs
    if backward:
        samples = samples._replace(yaw_rate=samples.yaw_rate.clone().requires_grad_())
    begin = time.process_time()
    with torch.set_grad_enabled(backward):
        belief = initial_belief(ekf.options, start)
        history = ekf(belief, samples, fixes, timing, method=method)
        if backward:
            (history.trajectory.azimuth.mean() + history.trajectory.lat.mean()).backward()
    return time.process_time() - begin, history


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, nargs="+", default=[60, 80])
    parser.add_argument("--window", type=int, default=60, help="seconds of each of 32 windows")
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument(
        "--states", type=int, choices=(7, 9), default=7, help="9 adds odometer delay and offset"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    terms = ("scale", "delay", "offset") if options.states == 9 else ("scale",)
    ekf = LooselyCoupledEkf(EkfOptions(speed_terms=terms))
    cases = [(f"{m} min, B=1", 60 * m, 1) for m in options.minutes]
    cases.append((f"{options.window} s, B=32", options.window, 32))
    print(f"{'drive':14} {'form':22} {'CPU s':>8} {'M/s':>8} {'x exact':>8}  note")
    for name, seconds, batch in cases:
        jobs = [("exact", False, seconds), ("fast", False, seconds), ("fast", True, seconds)]
        short = min(seconds, 60 if batch == 1 else 10)
        jobs += [("sequential", False, short), ("exact", True, min(seconds, 300))]
        base = 0.0
        for method, backward, length in jobs:
            inputs = drive(length, batch)
            count = 1 if method == "exact" and length > 600 else options.repeat
            runs = [timed(ekf, inputs, method, backward) for _ in range(count)]
            spent, history = min(runs, key=lambda r: r[0])
            rate = length * RATE * batch / spent / 1e6
            base = base or rate
            label = method + (" forward+backward" if backward else " forward")
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            note = f"{length} s, {history.method}, {history.passes} passes, peak {peak:.0f} MB"
            print(f"{name:14} {label:22} {spent:8.3f} {rate:8.4f} {rate / base:8.2f}  {note}")


if __name__ == "__main__":
    main()
