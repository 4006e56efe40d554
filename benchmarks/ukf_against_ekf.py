"""The unscented filter against the extended one: where they should differ, and where not.

    python benchmarks/ukf_against_ekf.py                       # seeds 11 to 16, four windows each
    python benchmarks/ukf_against_ekf.py --first-seed 200 --seeds 20

Windows of simulated drives (grade mems_m in 2D, its own gyro and odometer errors), started from
the truth but for the azimuth, with white noise in the fixes that both filters are told. In the rows
"start off by" the azimuth is off by just that to either side and the filter is told that deviation;
elsewhere it is drawn with 5°. All windows run as one batch, both filters on the same draws.

Time to converge: after it the azimuth stays within 5° to the window's end; a window that never does
counts in full. RMS errors and NEES (east, north, azimuth, per degree of freedom, median over the
windows; 1 is right) are those of the window's second half. Gains are by how much the mean over the
windows is smaller than the extended filter's, with a 95 % interval drawn by seed.
"""

import argparse
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from navlearn.attitude import wrap_angle
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import error_layout, initial_belief
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.bootstrap import bootstrap_interval, improvement
from navlearn.states import FixTiming, GnssFix, NavState, RissSample

RATE = 10
CONVERGED = math.radians(5.0)


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row: what is hard about it."""

    name: str
    profile: str = "mixed"
    start_deg: float | None = None
    period: int = 1
    position: float = 1.5
    velocity: float | None = 0.1
    grade: str = "mems_m"


OFF = (10, 30, 60, 90, 120, 150, 180)
CASES = (
    Case(name="as usual: fixes each 1 s"),
    *(Case(name=f"fixes each {s} s", period=s) for s in (5, 10, 30, 60)),
    *(Case(name=f"positions alone each {s} s", period=s, velocity=None) for s in (1, 10, 60)),
    Case(name="turns of a town, poor gyro, each 10 s", profile="town", grade="mems_x", period=10),
    Case(name="positions alone, 15 m", position=15.0, velocity=None),
    *(Case(name=f"start off by {a}°", start_deg=a) for a in OFF),
    *(Case(name=f"start off by {a}°, positions alone", start_deg=a, velocity=None) for a in OFF),
)


@dataclass
class Windows:
    """A batch of windows: samples from each start on, and the truth at every sample's end."""

    samples: RissSample
    truth: dict[str, torch.Tensor]
    start: NavState
    unit: np.ndarray


@lru_cache
def windows(profile, grade, seeds, count, seconds):
    """Return windows of drives that begin while the car moves."""
    parts = []
    for seed in seeds:
        length = 300.0 + count * seconds
        log = simulate_drive(
            profile=profile,
            grade=grade,
            duration=length,
            seed=seed,
            imu_rate_hz=float(RATE),
        ).log
        line, truth = riss_timeline(log, rate_hz=float(RATE)), log.reference
        values = {
            name: np.interp(line.t, truth["t"], np.unwrap(truth[name]) if turns else truth[name])
            for name, turns in (
                *((n, False) for n in ("lat", "height", "v_e", "v_n")),
                *((n, True) for n in ("lon", "azimuth")),
            )
        }
        moving = np.flatnonzero(np.hypot(values["v_e"], values["v_n"]) > 5.0)
        for wanted in np.linspace(moving[0], len(line.t) - seconds * RATE - 1, count):
            first = int(moving[np.searchsorted(moving, wanted).clip(max=len(moving) - 1)])
            first = min(first, len(line.t) - seconds * RATE - 1)
            cut = slice(first + 1, first + 1 + seconds * RATE)
            at = {name: torch.tensor(value[cut]) for name, value in values.items()}
            begin = [float(values[name][first]) for name in ("lat", "lon", "height", "azimuth")]
            parts.append(([channel[cut] for channel in line.samples], at, begin, seed))
    return Windows(
        RissSample(*(torch.stack(rows) for rows in zip(*(p[0] for p in parts), strict=True))),
        {name: torch.stack([p[1][name] for p in parts]) for name in parts[0][1]},
        NavState(*torch.tensor([p[2] for p in parts], dtype=torch.float64).T),
        np.array([p[3] for p in parts]),
    )


def both_signs(found):
    """Return every window twice."""

    def twice(tensor):
        return torch.cat((tensor, tensor))

    return Windows(
        RissSample(*map(twice, found.samples)),
        {name: twice(value) for name, value in found.truth.items()},
        NavState(*map(twice, found.start)),
        np.concatenate((found.unit, found.unit)),
    )


def fixes_of(case, found, generator):
    """Return fixes with white noise, and where they fall."""
    batch, length = found.samples.dt.shape
    index = torch.arange(case.period * RATE - 1, length, case.period * RATE)

    def noise(size):
        draws = torch.randn(batch, len(index), generator=generator, dtype=torch.float64)
        return size * draws

    at = {name: value[:, index] for name, value in found.truth.items()}
    spread = (noise(case.position), noise(case.position), noise(case.position))
    lat, lon, height = shift_geodetic(at["lat"], at["lon"], at["height"], *spread)
    std_v = case.velocity or 1.0
    one, zero = torch.ones_like(lat), torch.zeros_like(lat)
    fixes = GnssFix(
        lat=lat,
        lon=lon,
        height=height,
        v_e=at["v_e"] + noise(std_v),
        v_n=at["v_n"] + noise(std_v),
        v_u=zero,
        std_e=case.position * one,
        std_n=case.position * one,
        std_u=case.position * one,
        std_v=std_v * one,
        has_position=one,
        has_velocity=zero if case.velocity is None else one,
    )
    return fixes, FixTiming(index.expand(batch, -1).contiguous(), zero)


def outcome(options, found, fixes, timing, off, sigma):
    """Return figures per window: time to converge, RMS position and azimuth, NEES."""
    start = found.start._replace(azimuth=found.start.azimuth + off)
    belief = initial_belief(options, start, sigmas={"azimuth": sigma, "east": 1.0, "north": 1.0})
    with torch.no_grad():
        history = riss_filter(options)(belief, found.samples, fixes, timing, method="exact")
    truth = {name: torch.gather(value, 1, history.end) for name, value in found.truth.items()}
    state = history.belief.state
    place = [truth[name] for name in ("lat", "lon", "height")]
    east, north, _ = enu_between(state.lat, state.lon, state.height, *place)
    turn = wrap_angle(state.azimuth - truth["azimuth"])
    t = (history.end + 1).double() / RATE
    wide = turn.abs() >= CONVERGED
    last = torch.where(wide, t, torch.zeros_like(t)).amax(-1)
    span = found.samples.dt.shape[-1] / RATE
    rows = [0, 1, error_layout(options).azimuth]
    covariance = history.belief.covariance[..., rows, :][..., rows]
    error = torch.stack((east, north, turn), -1).unsqueeze(-1)
    nees = (error.mT @ torch.linalg.solve(covariance, error)).squeeze(-1).squeeze(-1) / 3.0
    later = (t > span / 2.0).double()

    def mean(values):
        return (values * later).sum(-1) / later.sum(-1)

    return {
        "never": wide[:, -1].double().numpy(),
        "time": torch.where(wide[:, -1], torch.full_like(last, span), last).numpy(),
        "position": mean(east**2 + north**2).sqrt().numpy(),
        "azimuth": torch.rad2deg(mean(turn**2).sqrt()).numpy(),
        "nees": mean(nees).numpy(),
    }


def told(ours, theirs, units):
    """Return a gain with its interval."""
    if not theirs.sum() > 0.0:
        return "–"
    gain = f"{improvement(ours, theirs):+.0f}"
    low, high = bootstrap_interval(ours, theirs, units)
    return gain if math.isnan(low) else f"{gain} ({low:+.0f} to {high:+.0f})"


def row(case, args):
    """Run both filters on a case and print what came of it."""
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    found = both_signs(windows(case.profile, case.grade, seeds, args.windows, args.seconds))
    generator = torch.Generator().manual_seed(args.first_seed)
    fixes, timing = fixes_of(case, found, generator)
    batch = len(found.unit)
    sigma = math.radians(case.start_deg or 5.0)
    off = sigma * torch.randn(batch, generator=generator, dtype=torch.float64)
    if case.start_deg is not None:
        off = sigma * torch.cat((torch.ones(batch // 2), -torch.ones(batch // 2))).double()
    noise = NoiseOptions(position_inflation=1.0, position_floor=0.1)
    plain = EkfOptions(noise=noise, velocity=case.velocity is not None)
    sets = {"EKF": plain, "UKF": replace(plain, unscented=UnscentedOptions(alpha=args.alpha))}
    made = {n: outcome(o, found, fixes, timing, off, sigma) for n, o in sets.items()}
    ekf, ukf = made.values()
    cells = [f"{case.name:38}"]
    for name, width in (("never", 4), ("time", 6), ("position", 6), ("azimuth", 6)):
        scale = 100.0 if name == "never" else 1.0
        digits = 0 if name == "never" else 1 if name == "time" else 2
        cells += [f"{scale * one[name].mean():{width}.{digits}f}" for one in (ekf, ukf)]
        if name != "never":
            cells.append(f"{told(ukf[name], ekf[name], found.unit):18}")
    cells += [f"{np.median(one['nees']):5.2f}" for one in (ekf, ukf)]
    print(" | ".join(cells), flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=11)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--windows", type=int, default=4, help="per seed")
    parser.add_argument("--seconds", type=int, default=240, help="length of a window")
    parser.add_argument(
        "--alpha", type=float, help="spread of the sigma points; √3 deviations if not given"
    )
    parser.add_argument("--cases", default="", help="only rows whose names hold this")
    args = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{2 * args.seeds * args.windows} windows of {args.seconds} s; each pair is EKF, UKF")
    print("case | never % | time to converge s, gain % | RMS position m | RMS azimuth ° | NEES")
    for case in CASES:
        if args.cases in case.name:
            row(case, args)


if __name__ == "__main__":
    main()
