"""How well velocity matching tells the attitude of a car that is already driving.

    NAVLEARN_DATA=../shared/data python benchmarks/ins_alignment.py

Simulated drives against their truth, KITTI drives against their reference, which their fixes are
made from (0.6 m white, 1.5 m correlated, 0.08 m/s). Every 25 s the attitude at the end of a window
of 1 Hz fixes: root mean square of pitch and roll, median and 90 % of azimuth where its own sigma
says that it is known to 3°, the errors in units of that deviation, and milliseconds per window.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch

from navlearn.attitude import matrix_from_angles, matrix_from_quaternion
from navlearn.errors import LogNotFoundError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimelineOptions, imu_timeline
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at
from navlearn.logs.synthetic import simulate_drive, with_aiding_from_reference
from navlearn.mechanization.ins_alignment import InsAlignment, InsAlignmentOptions
from navlearn.mechanization.matched_alignment import matched_at
from navlearn.mechanization.velocity_matching import MatchingOptions

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
KNOWN = math.radians(3.0)


def error_of(log: DriveLog, t: torch.Tensor, found: InsAlignment) -> np.ndarray:
    row = reference_at(log, t[found.sample : found.sample + 1]).iloc[0]
    angles = (torch.tensor(float(row[name])) for name in ("azimuth", "pitch", "roll"))
    truth = matrix_from_angles(*(angle.to(torch.float64) for angle in angles))
    turn = matrix_from_quaternion(found.state.q_lb) @ truth.T
    phi = torch.stack((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    return 0.5 * phi.numpy()


def show(name: str, log: DriveLog, window: float, course: bool) -> None:
    line = imu_timeline(log, options=ImuTimelineOptions(max_imu_gap=2.0))
    matching = MatchingOptions() if course else MatchingOptions(slip_sigma=math.inf)
    options = InsAlignmentOptions(window=window, matching=matching)
    errors, sigmas, spent, tried = [], [], 0.0, 0
    for m in range(12, len(line.fix_time), 25):
        begin = time.perf_counter()
        found = matched_at(line.samples, line.fixes, line.timing, m, options, bridged=line.bridged)
        spent += time.perf_counter() - begin
        tried += 1
        if found is not None:
            errors.append(error_of(log, line.t, found))
            sigmas.append(found.attitude_sigma.numpy())
    error, sigma = np.degrees(errors), np.degrees(sigmas)
    fine = np.isfinite(error).all(1)
    error, sigma = error[fine], sigma[fine]
    known = sigma[:, 2] < math.degrees(KNOWN)
    azimuth, ratio = np.abs(error[known, 2]), error / sigma
    median, most = np.quantile(azimuth, [0.5, 0.9]) if known.any() else (np.nan, np.nan)
    print(
        f"{name:18s} {window:5.0f} {'yes' if course else 'no':>6s} {len(error):4d} "
        f"{100.0 * known.mean():6.0f} {np.sqrt(np.mean(error[:, :2] ** 2)):7.3f} {median:8.2f} "
        f"{most:7.2f} {np.sqrt(np.mean(ratio[:, :2] ** 2)):7.2f} "
        f"{np.sqrt(np.mean(ratio[known, 2] ** 2)) if known.any() else np.nan:7.2f} "
        f"{1e3 * spent / tried:6.0f}"
    )


def drives(grades: list[str], seeds: list[int], kitti: list[str], duration: float):
    for grade in grades:
        for seed in seeds:
            made = simulate_drive(profile="town", grade=grade, duration=duration, seed=seed)
            yield f"{grade} {seed}", made.log
    for name in kitti:
        try:
            log = read_log(DATASETS / f"kitti_{name}.yaml")
        except LogNotFoundError as error:
            print(f"kitti_{name}: left out: {str(error).splitlines()[0]}")
            continue
        yield f"kitti_{name}", with_aiding_from_reference(log, odometer=None, seed=11)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grades", nargs="*", default=["tactical", "mems_m"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12])
    parser.add_argument("--kitti", nargs="*", default=["0018", "0027", "0033", "0034"])
    parser.add_argument("--windows", type=float, nargs="+", default=[15.0, 30.0, 60.0])
    parser.add_argument("--duration", type=float, default=600.0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{'drive':17s} window course    n known%  tilt °  az. 50%  az.90%  tilt/σ    az/σ     ms"
    )
    for name, log in drives(arguments.grades, arguments.seeds, arguments.kitti, arguments.duration):
        for window in arguments.windows:
            for course in (True, False):
                show(name, log, window, course)


if __name__ == "__main__":
    main()
