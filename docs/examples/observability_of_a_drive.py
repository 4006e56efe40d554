"""How well a full-IMU filter observes its states, phase by phase of a simulated drive.

Run it: python docs/examples/observability_of_a_drive.py [FOLDER]
With a folder, the record, its figures and the chapter of a report are written there.
"""

import math
import sys
from pathlib import Path

import numpy as np
import torch

from navlearn.attitude import quaternion_from_angles
from navlearn.fusion.ins.layout import INS_ERROR_UNITS
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions, InsNoiseOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.motion import KNOT_DISTANCE, KNOT_INTERVAL, Motion, uniform_spline
from navlearn.outages.observability_record import ObservabilityRecord, observability_of_run
from navlearn.outages.observability_report import write_observability
from navlearn.outages.observability_tables import Phase, direction_table
from navlearn.outages.output import prepare_output_folder
from navlearn.states import InsState

PHASES = {
    "at rest": 60.0,
    "speeding up": 68.0,
    "constant velocity": 128.0,
    "slower and faster": 148.0,
    "curves": 178.0,
    "straight again": 220.0,
}
"""When each ends, s."""

GNSS_ALONE = InsEkfOptions(
    odometer=False,
    nonholonomic=False,
    zero_velocity=False,
    zero_angular_rate=False,
    initial=InsInitialOptions(
        position=3.0, height=5.0, velocity=0.5, tilt=math.radians(1.0), azimuth=math.radians(5.0),
        gyro_bias=math.radians(0.2), accel_bias=0.08,
    ),
    noise=InsNoiseOptions(
        gyro_random_walk=1.7e-4, accel_random_walk=0.01, turn_noise=0.01, gyro_bias_walk=5e-6,
        accel_bias_walk=3e-4, position_floor=0.3, height_floor=0.5, position_inflation=1.5,
        velocity_floor=0.03,
    ),
)  # fmt: skip


def motion() -> Motion:
    """Return a level drive through the phases."""
    end = 220.0

    def speed(t: np.ndarray) -> np.ndarray:
        return np.interp(
            t, [61.0, 68.0, 129.0, 136.0, 140.0, 147.0], [0, 15.0, 15.0, 5.0, 5.0, 15.0]
        )

    def azimuth(t: np.ndarray) -> np.ndarray:
        inside = np.clip(t, 150.0, 176.0) - 150.0
        rate, wave = 0.15, 2.0 * np.pi / 13.0
        return 0.4 + rate * (1.0 - np.cos(wave * inside)) / wave

    def level(s: np.ndarray) -> np.ndarray:
        return 0.0 * s

    return Motion(
        duration=end,
        speed=uniform_spline(speed, end, KNOT_INTERVAL),
        azimuth=uniform_spline(azimuth, end, KNOT_INTERVAL),
        slope=uniform_spline(level, 4000.0, KNOT_DISTANCE),
        crossfall=uniform_spline(level, 4000.0, KNOT_DISTANCE),
        description="rest, straight, braking, curves",
    )


def recorded() -> ObservabilityRecord:
    """Filter the drive with GNSS alone, from a start known as well as the options say."""
    log = simulate_drive(profile=motion(), grade="mems_m", seed=11, imu_rate_hz=20.0).log
    line = imu_timeline(log)
    first = torch.tensor(
        [float(log.reference[x].iloc[0]) for x in ("lat", "lon", "height")]
    ).double()
    zero = torch.zeros((), dtype=torch.float64)
    start = InsState(
        *first, torch.zeros(3).double(), quaternion_from_angles(zero + 0.4, zero, zero)
    )
    ekf, belief = InsEkf(GNSS_ALONE), initial_ins_belief(GNSS_ALONE, start)
    with torch.no_grad():
        history = ekf(belief, line.samples, line.fixes, line.timing)
    return observability_of_run(
        history.belief.covariance,
        belief.covariance,
        line.t[history.end],
        start_time=line.start_time,
        names=ekf.model.layout.names,
        units=INS_ERROR_UNITS,
        still=line.samples.stationary[history.end],
    )


def phase_table(record: ObservabilityRecord) -> str:
    """Return what is left of deviations at the end of each phase, and the least observed."""
    shown = ("phi_east", "phi_north", "phi_up", "gyro_bias_z", "accel_bias_x", "accel_bias_y")
    where = [Phase(name=name, start=end, end=end) for name, end in PHASES.items()]
    left = np.sqrt(record.against_start)
    lines = ["| after | " + " | ".join(x.replace("_", " ") for x in shown) + " | least observed |"]
    lines.append("| --- |" + " ---: |" * len(shown) + " --- |")
    for one, row in zip(where, direction_table(record, where).to_dict("records"), strict=True):
        k = record.row_at(one.end)
        cells = [f"{left[k, record.names.index(x)]:.2f}" for x in shown]
        lines.append(f"| {one.name} | " + " | ".join(cells) + f" | {row['least_direction']} |")
    return "\n".join(lines)


if __name__ == "__main__":
    torch.set_num_threads(1)
    found = recorded()
    print(phase_table(found))
    if len(sys.argv) > 1:
        output = prepare_output_folder(Path(sys.argv[1]), force=True)
        chapter = write_observability(output, found, [], whose="`ins_ekf` with GNSS alone")
        pictures = (f"\n![{text}]({file})\n" for file, text in chapter.figures.items())
        output.claim("observability.md").write_text("\n".join([*chapter.section, *pictures]))
        output.finish()
