"""How long a simulated hour takes, by profile.

    python benchmarks/simulator.py --hours 1 --rate 100

One thread; CPU seconds, so that other work on the machine does not count.
"""

import argparse
import time

import torch

from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.profile import PROFILES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=100.0, help="IMU rate, Hz")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{'profile':10} {'km':>7} {'samples':>8} {'CPU s':>6} {'M samples/s':>12}")
    for profile in PROFILES:
        start = time.process_time()
        drive = simulate_drive(
            profile=profile, duration=3600.0 * options.hours, imu_rate_hz=options.rate
        )
        taken = time.process_time() - start
        samples = len(drive.log.imu)
        km = drive.ideal.odometer["speed"].mean() * options.hours * 3.6
        print(f"{profile:10} {km:7.1f} {samples:8d} {taken:6.2f} {samples / taken / 1e6:12.2f}")


if __name__ == "__main__":
    main()
