"""Velocity matching as an alignment: a window of a drive's fixes, ending at one of them."""

import torch
from torch import Tensor

from navlearn.mechanization.ins_alignment_result import (
    InsAlignment,
    InsAlignmentOptions,
    state_at_fix,
)
from navlearn.mechanization.levelling import gyro_bias_at_rest, last_rest
from navlearn.mechanization.matching_model import VelocityFixes, Window
from navlearn.mechanization.velocity_matching import match_velocity
from navlearn.states import FixTiming, GnssFix, ImuSample

SLOWEST = 1.0
"""A car that was never faster in a window tells no azimuth, m/s."""

JOINED = 0.05
"""Samples are joined to intervals of this length, s: a car hardly turns within."""

UNTOLD_CLIMB = 0.05
"""How steep a road may be, rad, where a receiver tells no vertical velocity."""


def matched_at(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    m: int,
    options: InsAlignmentOptions,
    window: float | None = None,
    *,
    bridged: Tensor | None = None,
) -> InsAlignment | None:
    """Return what velocity matching tells at one fix, however little that is.

    Args:
        samples: Intervals of one drive, shape (T,) and (T, 3) each.
        fixes: Fixes, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        m: The window ends at this fix, which has position and velocity.
        options: Thresholds and standard deviations.
        window: Length of the window, s; None takes that of the options.
        bridged: Where a gap in the IMU was bridged, bool, shape (T,): no window reaches across.

    Returns:
        The alignment, or None where the window has too few fixes, is too short, or the car hardly
        moved in it.
    """
    end = int(timing.index[m])
    gaps = torch.nonzero(bridged[: end + 1])[:, 0] if bridged is not None else timing.index[:0]
    earliest = int(gaps[-1]) if len(gaps) else 0
    used = _window(samples, fixes, timing, m, options, (earliest, window or options.window))
    if used is None:
        return None
    first = int(timing.index[used[0]])
    inside = ImuSample(*(channel[first + 1 : end + 1] for channel in samples))
    stops = _stops(inside.dt, timing.index[used] - first)
    bias, bias_sigma = gyro_bias_so_far(samples, fixes.lat[m], end, options)
    found = match_velocity(
        Window(
            samples=_joined(inside, stops),
            fixes=_velocities(fixes, timing, used, stops, options.velocity_sigma),
            lat=fixes.lat[m],
            height=fixes.height[m],
            lever_arm=bias.new_tensor(options.lever_arm),
        ),
        bias,
        bias_sigma,
        options.matching,
    )
    attitude, velocity, gyro, accel = found.covariance.diagonal().sqrt().view(4, 3).unbind(0)
    return InsAlignment(
        sample=end,
        state=state_at_fix(found.C_lb, found.v_l, fixes, timing, m, options.lever_arm),
        attitude_sigma=attitude,
        position_sigma=float(torch.maximum(fixes.std_e[m], fixes.std_n[m])),
        height_sigma=float(fixes.std_u[m]),
        velocity_sigma=velocity,
        gyro_bias=found.gyro_bias,
        gyro_bias_sigma=gyro,
        accel_bias=found.accel_bias,
        accel_bias_sigma=accel,
        method="velocity_matching",
    )


def gyro_bias_so_far(
    samples: ImuSample, lat: Tensor, end: int, options: InsAlignmentOptions
) -> tuple[Tensor, Tensor]:
    """Return what standstill has told of the gyro biases, and how well.

    Args:
        samples: Intervals, shape (T,) and (T, 3) each.
        lat: Latitude, rad, scalar.
        end: Nothing after this interval is looked at.
        options: How long a standstill must be, and standard deviations.

    Returns:
        Biases and their standard deviations, rad/s, shape (3,) each; zero and large where the car
        never stood.
    """
    rest = last_rest(samples, end + 1, options.standstill)
    like = samples.omega_ib_b[0]
    if rest is None:
        return torch.zeros_like(like), torch.full_like(like, options.gyro_bias_sigma)
    bias = gyro_bias_at_rest(rest.omega_ib_b, rest.f_b, lat)
    return bias, torch.full_like(like, options.gyro_bias_sigma_at_rest)


def _window(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    m: int,
    options: InsAlignmentOptions,
    reach: tuple[int, float],
) -> Tensor | None:
    """Return the fixes of the window that ends at fix ``m``, or None where they do not suffice.

    It reaches back to an interval, and no longer than a time, s.
    """
    earliest, length = reach
    clock = torch.cumsum(samples.dt, 0)
    time = clock[timing.index.clamp(min=0)]
    inside = (timing.index >= earliest) & (fixes.has_velocity > 0)
    inside = inside & (time >= time[m] - length - 1e-9)
    used = torch.nonzero(inside[: m + 1])[:, 0]
    if len(used) < max(options.least_fixes, 3):
        return None
    if float(time[m] - time[used[0]]) < options.least_window - 1e-9:
        return None
    fastest = float(torch.hypot(fixes.v_e[used], fixes.v_n[used]).max())
    return used if fastest > SLOWEST else None


def _stops(dt: Tensor, ends: Tensor) -> Tensor:
    """Return after how many samples joined intervals end: also at every fix."""
    count = len(dt)
    size = max(round(JOINED / max(float(dt.mean()), 1e-9)), 1)
    regular = torch.arange(0, count, size, device=ends.device)
    every: Tensor = torch.unique(torch.cat((regular, ends, ends.new_tensor([count]))))
    return every


def _joined(samples: ImuSample, stops: Tensor) -> ImuSample:
    """Return samples joined to intervals of about :data:`JOINED`, which matching takes as well."""
    dt = samples.dt
    length = _sums(dt, stops)

    def mean(channel: Tensor) -> Tensor:
        weight = dt if channel.dim() == 1 else dt.unsqueeze(-1)
        total = length if channel.dim() == 1 else length.unsqueeze(-1)
        return _sums(channel * weight, stops) / total

    return ImuSample(length, *(mean(channel) for channel in samples[1:]))


def _sums(channel: Tensor, stops: Tensor) -> Tensor:
    total = torch.cat((torch.zeros_like(channel[:1]), torch.cumsum(channel, 0)))
    return torch.diff(total[stops], dim=0)


def _velocities(
    fixes: GnssFix, timing: FixTiming, used: Tensor, stops: Tensor, least_sigma: float
) -> VelocityFixes:
    """Return the window's GNSS velocities; its samples begin after the first of them."""
    v_l = torch.stack((fixes.v_e, fixes.v_n, fixes.v_u), -1)[used]
    sigma = fixes.std_v[used].clamp(min=least_sigma).unsqueeze(-1).repeat(1, 3)
    if not bool(v_l[:, 2].any()):
        sigma[:, 2] += UNTOLD_CLIMB * torch.hypot(v_l[:, 0], v_l[:, 1])
    end = torch.searchsorted(stops, timing.index[used] - timing.index[used[0]]) - 1
    return VelocityFixes(end, timing.delay[used], v_l, sigma)
