"""What a drive told about the errors of its gyro: the azimuth error of running on without fixes.

Had GNSS been lost at any moment of the past, the azimuth would have strayed from what later fixes
told by the integral of the gyro's error. All such emulated outages, of any start and length, are
differences of one curve: the azimuth integrated from the raw gyro less what each fix told. Their
errors are correlated through the fixes at both ends, the gyro's noise and its wandering bias. A
filter of two states, azimuth and bias, turns curve and integrated terms into rows whose errors
are independent and of unit variance (Kalman's innovations, [Jazwinski1970] §7.3), so that least
squares on the rows is least squares with the whole covariance. Rows add up in order of time: the
normal equations of every past origin are sums over the rows before it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.errors import ConfigError, FitError
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import gyro_regressor
from navlearn.navigator import NavigatorRun
from navlearn.states import RissSample

AZIMUTH = 3
"""Where the azimuth stands in the error state of a filter without velocity states."""


@dataclass(frozen=True, kw_only=True)
class AzimuthNoise:
    """What the curve of azimuth errors holds beside the terms.

    Attributes:
        gyro_random_walk: Angle random walk of the gyro, rad/√s.
        turn_noise: What turning adds that no term explains, √s.
        gyro_bias_walk: Random walk of the gyro bias, rad/s/√s.
        gyro_bias: Deviation of the gyro bias at the start, rad/s.
        rest: Deviation of the mean yaw rate over one second of standstill, rad/s.
    """

    gyro_random_walk: float = math.radians(0.6) / 60.0
    turn_noise: float = 0.003
    gyro_bias_walk: float = math.radians(60.0) / 3600.0 / 60.0
    gyro_bias: float = math.radians(0.5)
    rest: float = math.radians(0.02)

    def __post_init__(self) -> None:
        for name in ("gyro_random_walk", "gyro_bias", "rest"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"azimuth noise: {name} is {getattr(self, name)}; it must be positive"
                )


class AzimuthCurve(NamedTuple):
    """The azimuth error of the raw gyro at the ends of blocks, and what integrates into it.

    Attributes:
        raw: Azimuth from the raw gyro, rad, shape (K,).
        error: Azimuth from the raw gyro minus what the fix told, rad, NaN without one, shape (K,).
        variance: Variance of what the fix told, rad², shape (K,).
        turned: Minus the integral of every term up to the block's end, rad, shape (K, J).
        moving: Time that the car moved within the block, over the cosine of its tilt, s,
            shape (K,).
        duration: Length of the block, s, shape (K,).
        turning: Integral of the squared yaw rate over the block, rad²/s, shape (K,).
        rest: Time at rest at the block's end, s; zero for a moving car, shape (K,).
        rest_rate: Mean yaw rate meanwhile less the Earth's, rad/s, shape (K,).
        rest_terms: Mean of every term meanwhile, shape (K, J).
        end: Last sample of the block, int64, shape (K,).
    """

    raw: Tensor
    error: Tensor
    variance: Tensor
    turned: Tensor
    moving: Tensor
    duration: Tensor
    turning: Tensor
    rest: Tensor
    rest_rate: Tensor
    rest_terms: Tensor
    end: Tensor


class AzimuthRows(NamedTuple):
    """Independent rows of unit variance: target = columns @ θ + noise.

    Attributes:
        columns: Shape (N, J).
        target: Shape (N,).
        sample: Sample after which each row is known, int64, not decreasing, shape (N,).
        angle: What the raw azimuth was off by at the end of each block, rad, and by how much less
            per unit of each coefficient, shape (K, 1 + J).
        bias: The same of the gyro bias, rad/s, shape (K, 1 + J).
        covariance: Of angle and bias were the coefficients known, shape (K, 2, 2).
    """

    columns: Tensor
    target: Tensor
    sample: Tensor
    angle: Tensor
    bias: Tensor
    covariance: Tensor


def azimuth_told(history: FilterHistory) -> tuple[Tensor, Tensor]:
    """Return what each fix told of the azimuth, as the filter weighed it.

    A fix took the azimuth from one mean and variance to another. The measurement of the azimuth
    alone that does the same has the variance 1 / (1/P⁺ − 1/P⁻), and its value does not depend
    on the mean before; so the gyro's error, which sits there, is not in it.

    Args:
        history: The filter's run over a drive.

    Returns:
        Azimuth (rad) and its variance (rad²; infinite where the fix told nothing), shape (K,).
    """
    before = history.prior.covariance[..., AZIMUTH, AZIMUTH]
    after = history.belief.covariance[..., AZIMUTH, AZIMUTH]
    share = (before - after) / before
    told = (history.fix >= 0) & (share > 1e-4)
    share = torch.where(told, share, 1.0)
    step = history.belief.state.azimuth - history.prior.state.azimuth
    azimuth = history.prior.state.azimuth + step / share
    variance = torch.where(told, after / share, math.inf)
    return azimuth, variance


def azimuth_curve(
    run: NavigatorRun, options: EkfOptions, terms: Tensor, end: int, *, least_rest: float = 0.5
) -> AzimuthCurve:
    """Return the azimuth error of the raw gyro over a run.

    Args:
        run: The filter's run.
        options: The filter's options.
        terms: Terms of the gyro's error at every sample before ``end``, shape (end, J).
        end: Only samples before this one exist.
        least_rest: A shorter standstill at a block's end tells nothing, s.

    Returns:
        The curve; one row per block that ends before ``end``.

    Raises:
        ConfigError: The filter has velocity states.
        FitError: No block ends before ``end``.
    """
    if options.has_velocity_states:
        raise ConfigError("azimuth regression: the Shen models are not supported; use bias_scale")
    history = run.history
    known = int((history.end < end).sum())
    if known < 2:
        raise FitError("azimuth regression: the filter has no past yet; start the outages later")
    ends = history.end[:known]
    samples = RissSample(*(channel[:end] for channel in run.samples))
    held = options.zero_speed or options.mechanization.hold_stationary
    moved = samples.dt * (1.0 - samples.stationary) if held else samples.dt
    if options.mechanization.compensates_tilt:
        moved = moved / (torch.cos(samples.pitch) * torch.cos(samples.roll))
    azimuth, variance = (x[:known] for x in azimuth_told(history))
    # The gyro terms of the filter itself are put back: the curve is that of the raw gyro.
    own = [gyro_regressor(name, samples) * moved for name in options.gyro_states]
    removed = torch.zeros_like(azimuth)
    if own:
        taken = sums_over_blocks(torch.stack(own, -1), ends)
        sensor = history.belief.sensor[:known, : len(own)]
        sensor = torch.cat((sensor[:1], sensor[:-1]))
        removed = (taken * sensor).sum(-1)
    start = history.belief.state.azimuth[:known]
    turn = history.prior.state.azimuth[1:known] - start[:-1] - removed[1:]
    raw = torch.cat((start[:1], start[0] + torch.cumsum(turn, 0)))
    integrals = sums_over_blocks(terms * moved.unsqueeze(-1), ends)
    integrals[0] = 0.0
    rest, rest_rate, rest_terms = _rest(samples, terms, ends, held)
    rest_rate = rest_rate - wgs84.EARTH_RATE * torch.sin(history.belief.state.lat[:known])
    at_rest = rest >= least_rest
    told = torch.isfinite(variance) & ~at_rest
    return AzimuthCurve(
        raw=raw,
        error=torch.where(told, raw - azimuth, math.nan),
        variance=variance,
        turned=-torch.cumsum(integrals, 0),
        moving=sums_over_blocks(moved.unsqueeze(-1), ends)[:, 0],
        duration=sums_over_blocks(samples.dt.unsqueeze(-1), ends)[:, 0],
        turning=sums_over_blocks((samples.yaw_rate.square() * moved).unsqueeze(-1), ends)[:, 0],
        rest=torch.where(at_rest, rest, 0.0),
        rest_rate=rest_rate,
        rest_terms=rest_terms,
        end=ends,
    )


def whitened_rows(curve: AzimuthCurve, noise: AzimuthNoise) -> AzimuthRows:
    """Return rows whose errors are independent and of unit variance.

    Args:
        curve: The curve of azimuth errors.
        noise: What it holds beside the terms.

    Returns:
        Rows in order of time; the first fix only tells where the curve begins.
    """
    measured = torch.cat((curve.error.unsqueeze(-1), curve.turned), -1).numpy()
    resting = torch.cat((curve.rest_rate.unsqueeze(-1), curve.rest_terms), -1).numpy()
    rest, variance = curve.rest.tolist(), curve.variance.tolist()
    moving, duration = curve.moving.tolist(), curve.duration.tolist()
    turning, told = curve.turning.tolist(), torch.isfinite(curve.error).tolist()
    angle, bias = np.zeros(measured.shape[1]), np.zeros(measured.shape[1])
    p_aa, p_ab, p_bb = 100.0, 0.0, noise.gyro_bias**2
    rows, places = [], []
    angles, biases, spreads = [], [], []
    for k in range(len(rest)):
        if k > 0:
            tau, walk = moving[k], noise.gyro_bias_walk**2 * duration[k]
            angle = angle - tau * bias
            q = noise.gyro_random_walk**2 * tau + noise.turn_noise**2 * turning[k]
            p_aa += -2.0 * tau * p_ab + tau * tau * (p_bb + walk / 3.0) + q
            p_ab += -tau * (p_bb + 0.5 * walk)
            p_bb += walk
        innovation, s = None, 1.0
        gain_a = gain_b = 0.0
        if rest[k] > 0.0:
            s = p_bb + noise.rest**2 / rest[k]
            innovation = resting[k] - bias
            gain_a, gain_b = p_ab / s, p_bb / s
            p_aa, p_ab, p_bb = p_aa - gain_a * p_ab, p_ab - gain_b * p_ab, p_bb - gain_b * p_bb
        elif told[k]:
            s = p_aa + variance[k]
            innovation = measured[k] - angle
            gain_a, gain_b = p_aa / s, p_ab / s
            p_bb, p_ab, p_aa = p_bb - gain_b * p_ab, p_ab - gain_a * p_ab, gain_a * variance[k]
        if innovation is not None:
            angle = angle + gain_a * innovation
            bias = bias + gain_b * innovation
            rows.append(innovation / math.sqrt(s))
            places.append(k)
        angles.append(angle)
        biases.append(bias)
        spreads.append((p_aa, p_ab, p_ab, p_bb))
    whole = torch.from_numpy(np.array(rows).reshape(-1, measured.shape[1]))
    return AzimuthRows(
        columns=whole[:, 1:],
        target=whole[:, 0],
        sample=curve.end[torch.tensor(places, dtype=torch.long)],
        angle=torch.from_numpy(np.stack(angles)),
        bias=torch.from_numpy(np.stack(biases)),
        covariance=torch.tensor(spreads, dtype=torch.float64).reshape(-1, 2, 2),
    )


def sums_over_blocks(values: Tensor, ends: Tensor) -> Tensor:
    """Return sums over blocks that end with the given samples, shape (K, n).

    Args:
        values: By sample, shape (T, n).
        ends: Last sample of each block, int64, shape (K,).
    """
    total = torch.cumsum(values, 0)[ends]
    return torch.diff(total, dim=0, prepend=torch.zeros_like(total[:1]))


def _rest(
    samples: RissSample, terms: Tensor, ends: Tensor, held: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return time at rest at each block's end, and mean rate and terms meanwhile."""
    still = (samples.stationary > 0.5) & held
    index = torch.arange(len(still))
    since_move = torch.cummax(torch.where(still, -1, index), 0).values[ends] + 1
    before = torch.cat((ends.new_zeros(1), ends[:-1] + 1))
    begin = torch.maximum(since_move, before)
    weight = samples.dt.unsqueeze(-1)
    values = torch.cat((weight, weight * samples.yaw_rate.unsqueeze(-1), weight * terms), -1)
    total = torch.nn.functional.pad(torch.cumsum(values, 0), (0, 0, 1, 0))
    sums = total[ends + 1] - total[begin]
    time = sums[:, 0].clamp(min=0.0)
    mean = sums[:, 1:] / time.clamp(min=1e-9).unsqueeze(-1)
    return time, mean[:, 0], mean[:, 1:]
