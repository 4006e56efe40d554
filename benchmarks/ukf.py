"""Speed of the three forms of the unscented filter beside those of the extended one.

    python benchmarks/ukf.py                             # an hour at 100 Hz, a batch of 32 windows
    python benchmarks/ukf.py --minutes 5 --window 10     # quick

CPU seconds of one thread; "x EKF" is the rate as a part of the extended filter's in the same form,
"x exact" of the unscented loop's, in the same run. The sequential forms run on a shorter stretch,
the backward pass of the loops too. The last column tells how far the fast form's trajectory and the
sequential one's are from the loop's, m.
"""

import argparse
import time

import torch
from ekf import RATE, drive

from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf

FORMS = (
    ("exact", False),
    ("fast", False),
    ("sequential", False),
    ("exact", True),
    ("fast", True),
)


def timed(filter_, inputs, method, backward):
    """Return CPU seconds and history of one run."""
    start, samples, fixes, timing = inputs
    if backward:
        samples = samples._replace(yaw_rate=samples.yaw_rate.clone().requires_grad_())
    begin = time.process_time()
    with torch.set_grad_enabled(backward):
        belief = initial_belief(filter_.options, start)
        history = filter_(belief, samples, fixes, timing, method=method)
        if backward:
            (history.trajectory.azimuth.mean() + history.trajectory.lat.mean()).backward()
    return time.process_time() - begin, history


def apart(history, other):
    """Return the largest distance between two trajectories, m."""
    pairs = enu_between(*history.trajectory[:3], *other.trajectory[:3])
    return max(float(x.abs().max()) for x in pairs)


def best(filter_, inputs, method, backward, repeat):
    """Return the least CPU seconds of some runs, and the last history."""
    runs = [timed(filter_, inputs, method, backward) for _ in range(repeat)]
    return min(spent for spent, _ in runs), runs[-1][1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, nargs="+", default=[60])
    parser.add_argument("--window", type=int, default=60, help="seconds of each of 32 windows")
    parser.add_argument("--repeat", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(1)
    ekf, ukf = LooselyCoupledEkf(), LooselyCoupledUkf()
    cases = [(f"{m} min, B=1", 60 * m, 1) for m in options.minutes]
    cases.append((f"{options.window} s, B=32", options.window, 32))
    head = f"{'drive':12} {'form':22} {'CPU s':>8} {'M/s':>8} {'x exact':>8} {'x EKF':>7}"
    print(f"{head} {'from exact':>11}  note")
    for name, seconds, batch in cases:
        base = 0.0
        for method, backward in FORMS:
            length = seconds
            if method == "sequential":
                length = min(seconds, 30 if batch == 1 else 5)
            elif method == "exact" and backward:
                length = min(seconds, 300)
            inputs = drive(length, batch)
            repeat = 1 if method == "exact" and length > 600 else options.repeat
            of_ekf, _ = best(ekf, inputs, method, backward, repeat)
            spent, history = best(ukf, inputs, method, backward, repeat)
            rate = length * RATE * batch / spent / 1e6
            base = base or rate
            away = ""
            if not backward:
                if method == "exact":
                    whole = history
                short = whole if length == seconds else timed(ukf, inputs, "exact", False)[1]
                away = "" if method == "exact" else f"{apart(history, short):.1e}"
            label = method + (" forward+backward" if backward else " forward")
            note = f"{length} s, {history.method}, {history.passes} passes"
            print(
                f"{name:12} {label:22} {spent:8.3f} {rate:8.4f} {rate / base:8.2f} "
                f"{of_ekf / spent:7.2f} {away:>11}  {note}"
            )


if __name__ == "__main__":
    main()
