"""Which motion of a car tells which error: rank and remaining deviation, full IMU and RISS.

Run it: python docs/examples/observability_by_motion.py
The first table is linear theory, GNSS position and velocity once a second for 40 s; the second
takes what RISS filters themselves linearise on such a road.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from navlearn.attitude import matrix_from_angles, quaternion_from_angles
from navlearn.earth import earth_rate_enu, normal_gravity, transport_rate_enu
from navlearn.filters.observability import (
    Observed,
    hidden_parts,
    left_of_states,
    observability_matrix,
    observability_rank,
)
from navlearn.fusion.error_state import initial_belief, initial_sigmas
from navlearn.fusion.ins.layout import ins_layout
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions
from navlearn.fusion.ins.start import initial_ins_sigmas
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.smoothing import SmoothingOptions, smooth
from navlearn.fusion.timeline import timeline
from navlearn.fusion.updates import measured
from navlearn.mechanization.preintegration import block_transition, preintegrate
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import FixTiming, GnssFix, InsState, NavState, RissSample

LAT = 0.76
POSITION_NOISE, VELOCITY_NOISE = 2.0, 0.1
INITIAL = InsInitialOptions(
    position=3.0, height=5.0, velocity=0.5, tilt=math.radians(1.0), azimuth=math.radians(5.0),
    gyro_bias=math.radians(0.2), accel_bias=0.08, gyro_scale=0.005, accel_scale=0.003,
)  # fmt: skip
TOLERANCE = 3e-6  # less than this share of the largest singular value is not called told


@dataclass(frozen=True)
class Second:
    """A second of a drive: acceleration (m/s²), right turn (rad/s) and speed in its middle."""

    acceleration: float
    turn: float
    speed: float


def drive(*pieces: tuple[int, float, float], speed: float) -> list[Second]:
    """Return a drive of pieces of (seconds, acceleration, right turn)."""
    seconds = []
    for length, acceleration, turn in pieces:
        for _ in range(length):
            seconds.append(Second(acceleration, turn, speed + 0.5 * acceleration))
            speed += acceleration
    return seconds


MOTIONS = {
    "at rest": drive((40, 0.0, 0.0), speed=0.0),
    "constant velocity": drive((40, 0.0, 0.0), speed=15.0),
    "one acceleration, constant": drive((40, 0.5, 0.0), speed=5.0),
    "straight, faster and slower": drive(
        (10, 0.0, 0.0), (5, 2.0, 0.0), (10, 0.0, 0.0), (5, -2.0, 0.0), (10, 0.0, 0.0), speed=15.0
    ),
    "a curve": drive((40, 0.0, 0.1), speed=15.0),
    "straight, then a curve": drive((25, 0.0, 0.0), (15, 0.0, 0.1), speed=15.0),
}


def imu_transitions(seconds: list[Second], states: int) -> Tensor:
    """Return Φ of every second of a level drive, shape (K, n, n), all of them at once."""
    turn, speed, gain = (
        torch.tensor([getattr(one, name) for one in seconds], dtype=torch.float64)
        for name in ("turn", "speed", "acceleration")
    )
    zero, azimuth = torch.zeros_like(turn), torch.cumsum(turn, 0) - turn
    lat, height = zero + LAT, zero + 100.0
    ahead = matrix_from_angles(azimuth, zero, zero)[..., 1]
    middle = matrix_from_angles(azimuth + 0.5 * turn, zero, zero)
    v_l = ahead * (speed - 0.5 * gain).unsqueeze(-1)
    frame = earth_rate_enu(lat) + transport_rate_enu(lat, height, v_l[:, 0], v_l[:, 1])
    omega = (middle.mT @ frame.unsqueeze(-1)).squeeze(-1) - torch.stack((zero, zero, turn), -1)
    force = torch.stack((speed * turn, gain, normal_gravity(lat, height)), -1)
    pre = preintegrate(
        omega.unsqueeze(1).expand(-1, 10, -1),
        force.unsqueeze(1).expand(-1, 10, -1),
        0.1 + zero.unsqueeze(1).expand(-1, 10),
        scale_factors=True,
    )
    start = InsState(lat, zero, height, v_l, quaternion_from_angles(azimuth, zero, zero))
    phi, _ = block_transition(start, pre, torch.zeros(12, dtype=torch.float64))
    return phi[:, :states, :states]


def imu_window(seconds: list[Second], states: int) -> tuple[Observed, tuple[str, ...]]:
    """Return what fixes of position and velocity tell a full IMU, and the states' names."""
    options = InsEkfOptions(states=states, odometer=False, initial=INITIAL)
    phi = imu_transitions(seconds, states)
    H = torch.eye(states, dtype=torch.float64)[:6].expand(len(seconds), -1, -1)
    noise = torch.tensor([POSITION_NOISE] * 3 + [VELOCITY_NOISE] * 3, dtype=torch.float64)
    deviations = initial_ins_sigmas(options)
    matrix = observability_matrix(phi, H)
    found = observability_rank(matrix, deviations, noise=noise, tolerance=TOLERANCE)
    return found, ins_layout(options).names


def riss_window(seconds: list[Second], options: EkfOptions) -> tuple[Observed, tuple[str, ...]]:
    """Return what fixes tell a RISS filter, by its own Φ and H along an error-free drive."""
    rate, count = 10, len(seconds)
    speed = torch.tensor([one.speed for one in seconds], dtype=torch.float64)
    gain = torch.tensor([one.acceleration for one in seconds], dtype=torch.float64)
    within = (torch.arange(rate, dtype=torch.float64) + 0.5) / rate - 0.5
    v = (speed[:, None] + gain[:, None] * within).flatten()
    turn = torch.tensor([one.turn for one in seconds], dtype=torch.float64)
    zero = torch.zeros_like(v)
    earth = 7.292115e-5 * math.sin(LAT)
    still = (v == 0.0).to(v)
    samples = RissSample(
        zero + 1.0 / rate, earth - turn.repeat_interleave(rate), v, *([zero] * 4), still
    )
    start = NavState(*(torch.tensor(x, dtype=torch.float64) for x in (LAT, 0.1, 100.0, 0.4)))
    path = riss_over_time(start, samples)
    index = torch.arange(rate - 1, rate * count, rate)
    one = torch.ones(count, dtype=torch.float64)
    azimuth, ends = path.azimuth[index], speed + 0.5 * gain
    fixes = GnssFix(
        path.lat[index], path.lon[index], path.height[index],
        ends * torch.sin(azimuth), ends * torch.cos(azimuth), 0.0 * one,
        *([POSITION_NOISE * one] * 3), VELOCITY_NOISE * one, one, one,
    )  # fmt: skip
    timing = FixTiming(index, 0.0 * one)
    ekf, belief = LooselyCoupledEkf(options), initial_belief(options, start)
    with torch.no_grad():
        history = ekf(belief, samples, fixes, timing, method="exact")
        once = SmoothingOptions(passes=1)
        phi = smooth(ekf, belief, samples, fixes, timing, history, once).transition
        line = timeline(
            ekf.model,
            RissSample(*(x[None] for x in samples)),
            GnssFix(*(x[None] for x in fixes)),
            FixTiming(*(x[None] for x in timing)),
        )
        prior = type(history.prior)(
            NavState(*(x[None] for x in history.prior.state)), *(x[None] for x in history.prior[1:])
        )
        told = measured(ekf.model.measurement, prior, line.occasion, ekf.noise)
    noise = told.variance[0].sqrt().flatten()
    matrix = observability_matrix(phi, told.observation[0])
    found = observability_rank(matrix, initial_sigmas(options), noise=noise, tolerance=TOLERANCE)
    return found, ekf.model.layout.names


def table(header: list[str], lines: list[list[str]]) -> str:
    """Return a Markdown table."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [header, rule, *lines])


def imu_table() -> str:
    """Return rank and what is left per motion, full IMU."""
    shown = ("phi_east", "phi_north", "phi_up", "gyro_bias_z", "accel_bias_x", "accel_bias_y")
    lines = []
    for name, seconds in MOTIONS.items():
        ranks = [str(int(imu_window(seconds, states)[0].rank)) for states in (9, 15, 21)]
        found, names = imu_window(seconds, 15)
        left = left_of_states(found)
        told = str(int((found.singular_values >= 1.0).sum()))
        lines.append([name, *ranks, told, *(f"{float(left[names.index(x)]):.2f}" for x in shown)])
    header = ["motion", "of 9", "of 15", "of 21", "s ≥ 1", *(x.replace("_", " ") for x in shown)]
    return table(header, lines)


def riss_table() -> str:
    """Return rank, hidden states and what is left of the azimuth per motion and RISS model."""
    lines = []
    for model in ("shen2010", "shen2010_full", "bias_scale"):
        for name in ("at rest", "constant velocity", "a curve", "straight, faster and slower"):
            cells = []
            for velocity in (False, True):
                options = EkfOptions(model=model, velocity=velocity)
                found, names = riss_window(MOTIONS[name], options)
                parts = zip(names, hidden_parts(found).tolist(), strict=True)
                hidden = ", ".join(x.replace("_", " ") for x, part in parts if part > 0.01)
                left = float(left_of_states(found)[names.index("azimuth")])
                cells += [f"{int(found.rank)} of {len(names)}", hidden or "–", f"{left:.2f}"]
            lines.append([f"`{model}`, {name}", *cells])
    kinds = ("position", "and velocity")
    header = [f"{what}, {kind}" for kind in kinds for what in ("rank", "hidden", "azimuth left")]
    return table(["model, motion", *header], lines)


if __name__ == "__main__":
    print(imu_table(), riss_table(), sep="\n\n")
