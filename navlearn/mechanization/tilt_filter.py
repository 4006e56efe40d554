"""Tilt of a car sample by sample: the streaming form of :mod:`navlearn.mechanization.tilt`."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from navlearn.mechanization.low_pass import low_pass_step
from navlearn.mechanization.tilt import Tilt, TiltOptions, tilt_angles


class TiltState(NamedTuple):
    """What the streaming tilt remembers; made by :meth:`TiltFilter.begin`.

    Attributes:
        forward: Low-passed γ sin p of every section, m/s², shape (..., n).
        transversal: Low-passed −γ cos p sin r of every section, m/s², shape (..., n).
        f_y: Last forward specific force, m/s², shape (...).
        level_f_x: Last transversal specific force plus speed times yaw rate, m/s², shape (...).
        speed: Last speed, m/s, shape (...).
        dt: Last interval, s, shape (...).
    """

    forward: Tensor
    transversal: Tensor
    f_y: Tensor
    level_f_x: Tensor
    speed: Tensor
    dt: Tensor


class TiltFilter(nn.Module):
    """Tilt sample by sample, scriptable."""

    static: bool
    time_constant: float
    sections: int

    def __init__(self, options: TiltOptions | None = None) -> None:
        """Keep the options.

        Args:
            options: Choices; None means the defaults.
        """
        super().__init__()
        options = options or TiltOptions()
        self.static = options.method == "static"
        self.time_constant = options.time_constant
        self.sections = options.sections

    @torch.jit.export
    def begin(
        self, f_y: Tensor, f_x: Tensor, speed: Tensor, yaw_rate: Tensor, dt: Tensor
    ) -> TiltState:
        """Return the state after the first sample, at rest on it.

        Args:
            f_y: Mean forward specific force, m/s², shape (...).
            f_x: Mean transversal specific force, m/s², shape (...).
            speed: Mean odometer speed, m/s, shape (...).
            yaw_rate: Mean yaw rate, rad/s, shape (...).
            dt: Length of the interval, s, shape (...).

        Returns:
            State whose tilt :meth:`tilt` reads.
        """
        level_f_x = f_x if self.static else f_x + speed * yaw_rate
        forward = torch.stack([f_y] * self.sections, -1)
        transversal = torch.stack([level_f_x] * self.sections, -1)
        return TiltState(forward, transversal, f_y, level_f_x, speed, dt)

    @torch.jit.export
    def step(
        self,
        state: TiltState,
        f_y: Tensor,
        f_x: Tensor,
        speed: Tensor,
        yaw_rate: Tensor,
        dt: Tensor,
    ) -> TiltState:
        """Return the state after one more sample.

        Args:
            state: State before.
            f_y: Mean forward specific force, m/s², shape (...).
            f_x: Mean transversal specific force, m/s², shape (...).
            speed: Mean odometer speed, m/s, shape (...).
            yaw_rate: Mean yaw rate, rad/s, shape (...).
            dt: Length of the interval, s, shape (...).

        Returns:
            State after.
        """
        level_f_x = f_x if self.static else f_x + speed * yaw_rate
        if self.static:
            forward, transversal = f_y, level_f_x
        else:
            between = 0.5 * (dt + state.dt)
            between = torch.where(between > 0.0, between, torch.ones_like(between))
            forward = 0.5 * (f_y + state.f_y) - (speed - state.speed) / between
            transversal = 0.5 * (level_f_x + state.level_f_x)
        return TiltState(
            low_pass_step(state.forward, forward, dt, self.time_constant),
            low_pass_step(state.transversal, transversal, dt, self.time_constant),
            f_y,
            level_f_x,
            speed,
            dt,
        )

    @torch.jit.export
    def tilt(self, state: TiltState, gravity: Tensor) -> Tilt:
        """Return the tilt that a state tells.

        Args:
            state: State after :meth:`begin` or :meth:`step`.
            gravity: Normal gravity, m/s², shape (...).

        Returns:
            Tilt, shape (...) each.
        """
        return tilt_angles(state.forward[..., -1], state.transversal[..., -1], gravity)

    def forward(
        self,
        f_y: Tensor,
        f_x: Tensor,
        speed: Tensor,
        yaw_rate: Tensor,
        dt: Tensor,
        gravity: Tensor,
    ) -> Tilt:
        """Return the tilt over a record, one step after another.

        Args:
            f_y: Mean forward specific force, m/s², shape (..., T).
            f_x: Mean transversal specific force, m/s², shape (..., T).
            speed: Mean odometer speed, m/s, shape (..., T).
            yaw_rate: Mean yaw rate, rad/s, shape (..., T).
            dt: Length of the intervals, s, shape (..., T).
            gravity: Normal gravity, m/s², shape (...).

        Returns:
            Tilt, shape (..., T) each.
        """
        state = self.begin(f_y[..., 0], f_x[..., 0], speed[..., 0], yaw_rate[..., 0], dt[..., 0])
        first = self.tilt(state, gravity)
        pitch, roll, clamped = [first.pitch], [first.roll], [first.clamped]
        for k in range(1, f_y.shape[-1]):
            state = self.step(
                state, f_y[..., k], f_x[..., k], speed[..., k], yaw_rate[..., k], dt[..., k]
            )
            now = self.tilt(state, gravity)
            pitch.append(now.pitch)
            roll.append(now.roll)
            clamped.append(now.clamped)
        return Tilt(torch.stack(pitch, -1), torch.stack(roll, -1), torch.stack(clamped, -1))
