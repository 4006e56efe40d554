"""Named regressors from what gyro, odometer and accelerometers told, row by row.

Every channel of a row depends on that row and on earlier ones only, so the same function serves
a record and a stream. Angles turned and times are counted from the start of the record given:
for an outage, from its start. The time since the last fix stands in for the step counter d of
[Jaradat2017], who name it as an input of the network; divided by a stated time it is of the
order of one.
"""

import torch
from torch import Tensor

from navlearn.errors import ConfigError, ShapeError
from navlearn.states import RissSample

CHANNELS = (
    "yaw_rate",
    "abs_yaw_rate",
    "speed",
    "acceleration",
    "lateral_acceleration",
    "f_x",
    "f_y",
    "pitch",
    "roll",
    "stationary",
    "turned_angle",
    "sin_turned_angle",
    "cos_turned_angle",
    "distance",
    "delay",
)


def build_regressors(
    sample: RissSample,
    names: tuple[str, ...],
    *,
    since_fix: Tensor | None = None,
    delay_scale: float = 60.0,
) -> Tensor:
    """Return the named channels, shape (..., T, m).

    Args:
        sample: Interval means, shape (..., T) each.
        names: Channels, any of ``CHANNELS``, in the order wanted.
        since_fix: Time since the last fix at the end of each interval, s, shape (..., T); None
            counts it from the start of the record.
        delay_scale: What ``delay`` is divided by, s.

    Raises:
        ConfigError: A name is unknown, or ``delay_scale`` is not positive.
        ShapeError: ``since_fix`` has another shape than the samples.
    """
    unknown = [name for name in names if name not in CHANNELS]
    if unknown or not names:
        raise ConfigError(
            f"regressors: {', '.join(unknown) or 'none named'}; choose from {', '.join(CHANNELS)}"
        )
    if not delay_scale > 0.0:
        raise ConfigError(f"regressors: delay_scale is {delay_scale} s; it must be positive")
    if since_fix is None:
        since_fix = sample.dt.cumsum(-1)
    if since_fix.shape != sample.dt.shape:
        raise ShapeError(
            f"regressors: since_fix has shape {tuple(since_fix.shape)} and the samples "
            f"{tuple(sample.dt.shape)}"
        )
    return torch.stack(
        [_channel(name, sample, since_fix / delay_scale) for name in names], -1
    ).double()


def _channel(name: str, sample: RissSample, delay: Tensor) -> Tensor:
    """Return one channel, shape (..., T)."""
    if name == "delay":
        return delay
    if name == "abs_yaw_rate":
        return sample.yaw_rate.abs()
    if name == "acceleration":
        return forward_acceleration(sample.speed, sample.dt)
    if name == "lateral_acceleration":
        return sample.speed * sample.yaw_rate
    if name == "distance":
        return (sample.speed * sample.dt).cumsum(-1)
    if name.endswith("turned_angle"):
        angle = (sample.yaw_rate * sample.dt).cumsum(-1)
        return {"sin": angle.sin(), "cos": angle.cos()}.get(name[:3], angle)
    channel: Tensor = getattr(sample, name)
    return channel


def forward_acceleration(speed: Tensor, dt: Tensor) -> Tensor:
    """Return the change of mean speed against the interval before, m/s²; zero in the first.

    Args:
        speed: Mean speed over each interval, m/s, shape (..., T).
        dt: Length of each interval, s, shape (..., T); zero marks padding, which gets zero.

    Returns:
        Shape (..., T).
    """
    between = 0.5 * (dt[..., 1:] + dt[..., :-1])
    moves = (dt[..., 1:] > 0) & (dt[..., :-1] > 0)
    change = speed[..., 1:] - speed[..., :-1]
    rate = torch.where(moves, change / torch.where(moves, between, 1.0), 0.0)
    return torch.nn.functional.pad(rate, [1, 0])


def average_samples(sample: RissSample, block: int) -> RissSample:
    """Return means over blocks of intervals, weighted by their length; a rest is dropped.

    Args:
        sample: Interval means, shape (..., T) each.
        block: Intervals per block.

    Returns:
        Shape (..., T // block); ``stationary`` is 1 where the whole block stood still.

    Raises:
        ConfigError: The block is shorter than one interval or longer than the record.
    """
    steps = sample.dt.shape[-1]
    if not 1 <= block <= max(steps, 1):
        raise ConfigError(f"average_samples: block is {block}; the record has {steps} intervals")
    whole = steps // block * block

    def blocks(channel: Tensor) -> Tensor:
        return torch.unflatten(channel[..., :whole], -1, (whole // block, block))

    dt = blocks(sample.dt)
    total = dt.sum(-1)
    share = dt / torch.where(total > 0, total, 1.0).unsqueeze(-1)
    means = {
        name: (share * blocks(channel)).sum(-1)
        for name, channel in sample._asdict().items()
        if name not in ("dt", "stationary")
    }
    stationary = blocks(sample.stationary).amin(-1)
    return RissSample(dt=total, stationary=stationary, **means)
