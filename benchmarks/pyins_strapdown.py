"""Strapdown mechanization beside pyins on the same error-free samples, in one run.

A simulated drive with ideal sensors is mechanized by pyins (a numba loop) and by the forms of this
package; each is set against the truth and against the others. pyins leaves out what flattening and
the square of the height change about gravity, 1e-6 m/s² at 80 m, so its height drifts by a
decimetre in ten minutes; "same gravity" tells its forces the difference. Speed: CPU seconds of one
thread over a long drive from raw samples, coning and sculling included, the least of the repeats;
pyins is compiled before, and a form that goes sample by sample does half a minute. Command:

    python benchmarks/pyins_strapdown.py [--seconds 600] [--seeds 11 12] [--minutes 60]

pyins is installed by: pip install git+https://github.com/nmayorov/pyins
"""

import argparse
import importlib.util
import itertools
import time
import warnings

import numpy as np
import torch
from beside_pyins import frames

from navlearn.mechanization.strapdown_ecef import from_ecef, strapdown_ecef_in_turn, to_ecef
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.states import ImuSample, InsState


def earth_centred(start, samples):
    """Return the states of the Earth-centred form, which goes sample by sample."""
    return from_ecef(strapdown_ecef_in_turn(to_ecef(start), samples))


OURS = {"local level": strapdown_over_time, "Earth-centred": earth_centred}
"""Mechanizations of this package: start, shape (1,), and samples to states, shape (1, T)."""

IN_TURN = 3000
"""Samples on which the speed of a form that goes sample by sample is taken."""


def integrated(start, increments):
    """Return the trajectory of pyins from increments."""
    from pyins.strapdown import Integrator

    integrator = Integrator(start)
    integrator.integrate(increments)
    return integrator.trajectory.iloc[1:]


def solutions_of(log):
    """Return the solution of every mechanization, and the truth, at every sample."""
    truth = frames.states_of(log.reference)
    start = InsState(*(x[:1] for x in truth))
    sample = frames.imu_sample(log.imu)
    found = {"truth": frames.solution_of(InsState(*(x[1:] for x in truth)))}
    with torch.no_grad():
        for name, run in OURS.items():
            states = run(start, sample)
            found[name] = frames.solution_of(InsState(*(x[0] for x in states)))
    first = frames.pyins_pva(frames.solution_of(start), 0.0)
    for name, imu in (
        ("pyins", log.imu),
        ("pyins, same gravity", frames.with_gravity_of_pyins(log)),
    ):
        found[name] = frames.of_pyins(integrated(first, frames.pyins_increments(imu)))
    return found


def greatest(one, other):
    """Return the greatest difference: horizontal, vertical (m), velocity (m/s), attitude (rad)."""
    place, velocity, phi = frames.difference(one, other)
    return (
        np.hypot(place[:, 0], place[:, 1]).max(),
        np.abs(place[:, 2]).max(),
        np.linalg.norm(velocity, axis=1).max(),
        np.linalg.norm(phi, axis=1).max(),
    )


def print_accuracy(seconds, seed):
    found = solutions_of(frames.drive(seconds, seed).log)
    pairs = [(name, "truth") for name in found if name != "truth"]
    pairs += [(name, "pyins, same gravity") for name in OURS]
    pairs += itertools.combinations(OURS, 2)
    print(f"\nseed {seed}, {seconds} s: greatest difference")
    print(f"{'':42} horizontal, m  vertical, m  velocity, m/s  attitude, °")
    for one, other in pairs:
        flat, up, velocity, angle = greatest(found[one], found[other])
        print(
            f"{one + ' against ' + other:42} {flat:13.2e} {up:12.2e} {velocity:14.2e} "
            f"{np.rad2deg(angle):12.2e}"
        )


def print_speed(minutes, repeats):
    log = frames.drive(60 * minutes, 11).log
    start = InsState(*(x[:1] for x in frames.states_of(log.reference)))
    first = frames.pyins_pva(frames.solution_of(start), 0.0)
    sample, increments = frames.imu_sample(log.imu), frames.pyins_increments(log.imu)
    few = ImuSample(*(x[:, :IN_TURN] for x in sample))
    jobs = {
        "pyins": lambda: integrated(first, frames.pyins_increments(log.imu)),
        "pyins, increments given": lambda: integrated(first, increments),
        "local level": lambda: strapdown_over_time(start, sample),
        "Earth-centred, in turn": lambda: earth_centred(start, few),
    }
    integrated(first, increments.iloc[:10])
    print(f"\n{minutes} min, {len(log.imu)} samples       CPU s      M/s  x pyins")
    base = 0.0
    for name, job in jobs.items():
        runs = []
        for _ in range(repeats):
            begin = time.process_time()
            with torch.no_grad():
                job()
            runs.append(time.process_time() - begin)
        count = few.dt.shape[1] if name.endswith("in turn") else len(log.imu)
        rate = count / min(runs) / 1e6
        base = base or rate
        print(f"{name:24} {min(runs):9.3f} {rate:8.4f} {rate / base:8.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--seeds", type=int, nargs="*", default=[11, 12])
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    if importlib.util.find_spec("pyins") is None:
        print(frames.MISSING)
        return
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")  # pandas tells pyins of what it will drop
    for seed in args.seeds:
        print_accuracy(args.seconds, seed)
    print_speed(args.minutes, args.repeats)


if __name__ == "__main__":
    main()
