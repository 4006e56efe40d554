"""What a tightly coupled filter asks of a vehicle: RISS and full IMU answer alike.

The tight filter knows nothing of mechanization. A vehicle lays its samples out in blocks that end
where ranges are received, predicts over blocks with its transition, measures what it measures of
itself (standstill, odometer, axle), tells where its antenna is, and takes corrections.
"""

from typing import Any, NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.blocks import Blocks
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Rows
from navlearn.fusion.recursion import unstacked
from navlearn.fusion.tight.passes import VehicleAhead as VehicleAhead
from navlearn.fusion.tight.passes import VehiclePasses
from navlearn.states import FixTiming, GnssFix, InsState, Trajectory

AnyBelief = TypeVar("AnyBelief", Belief, InsBelief)


class VehicleLine(NamedTuple):
    """A batch of drives laid out in blocks.

    Attributes:
        blocks: Where the blocks are; ``blocks.fix`` counts receptions of ranges.
        line: The vehicle's own timeline, whose samples and occasions are of shape (B, K, ...).
        delay: End of each block minus the time of the reception, s, shape (B, K).
    """

    blocks: Blocks
    line: Any
    delay: Tensor


class Antenna(NamedTuple):
    """Where the antenna was when the ranges were received, and how a correction moves it.

    Attributes:
        lat: Latitude, rad, shape (...).
        lon: Longitude, rad, shape (...).
        height: Height above the ellipsoid, m, shape (...).
        velocity: Velocity against the Earth, east, north, up, m/s, shape (..., 3).
        position_by_error: Change of its position east, north, up per correction, shape (..., 3, n).
        velocity_by_error: Change of its velocity per correction, shape (..., 3, n).
        velocity_variance: Variance of its velocity beyond that of the error states, the same for
            all satellites, m²/s², shape (..., 3): noise of the odometer, and hills where a
            mechanization does not climb.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    velocity: Tensor
    position_by_error: Tensor
    velocity_by_error: Tensor
    velocity_variance: Tensor


class Vehicle(Protocol[AnyBelief]):
    """A vehicle under a tightly coupled filter; batch-first, differentiable, without state.

    Attributes:
        names: Names of its n error states, in order.
        rows: Rows of what it measures of itself; GNSS fixes are among the kinds where asked.
        limits: Largest NIS that the gate lets pass, per kind taken.
        gate: When a measurement is refused.
        anchor: As in :class:`navlearn.fusion.gating.Gated`, among the vehicle's own kinds.
        company: The same.
        unscented: Sigma points by which it is carried and measured; None for its linear models.
    """

    @property
    def names(self) -> tuple[str, ...]: ...  # noqa: D102

    @property
    def rows(self) -> Rows: ...  # noqa: D102

    @property
    def limits(self) -> tuple[float, ...]: ...  # noqa: D102

    @property
    def gate(self) -> GateOptions: ...  # noqa: D102

    @property
    def anchor(self) -> int | None: ...  # noqa: D102

    @property
    def company(self) -> tuple[int, ...]: ...  # noqa: D102

    @property
    def unscented(self) -> UnscentedOptions | None: ...  # noqa: D102

    def laid_out(self, samples: Any, fixes: GnssFix | None, timing: FixTiming) -> VehicleLine:
        """Return drives in blocks that end where ranges are received.

        Args:
            samples: Samples, batch shape (B, T).
            fixes: Fixes at the same moments as the ranges, shape (B, M) each, or None.
            timing: Where the receptions fall, shape (B, M) each.
        """
        ...

    def all_blocks(self, line: VehicleLine) -> Any:
        """Return what the methods below take of all blocks at once, batch shape (B, K).

        A tree of named tuples of tensors: :func:`blocks_in_turn` takes it apart.
        """
        ...

    def block(self, line: VehicleLine, k: int) -> Any:
        """Return the same of one block, batch shape (B,)."""
        ...

    def predicted(self, belief: AnyBelief, block: Any) -> VehicleAhead:
        """Return the prediction over blocks from the beliefs at their starts."""
        ...

    def predicted_in_turn(self, belief: AnyBelief, block: Any) -> VehicleAhead:
        """Return the same prediction sample by sample: the oracle of :meth:`predicted`."""
        ...

    def carried(self, belief: AnyBelief, block: Any) -> AnyBelief:
        """Return beliefs moved over blocks, their covariance as it was.

        Args:
            belief: Beliefs at the starts of blocks, batch shape (..., P).
            block: The blocks, batch shape (..., P), see
                :func:`navlearn.fusion.tight.trees.for_points`.
        """
        ...

    def carried_in_turn(self, belief: AnyBelief, block: Any) -> AnyBelief:
        """Return the same sample by sample: the oracle of :meth:`carried`."""
        ...

    def carried_apart(self, belief: AnyBelief, deviation: Tensor, block: Any) -> Tensor:
        """Return how far from the first point others are at the ends of blocks.

        Args:
            belief: Belief at the starts of blocks, batch shape (...).
            deviation: Points about it in the order of the error state, shape (..., P, n); the
                first is zero.
            block: The blocks, batch shape (...).

        Returns:
            Shape (..., P, n).
        """
        ...

    def moved_at_start(self, belief: AnyBelief, correction: Tensor, block: Any) -> AnyBelief:
        """Return beliefs at the starts of blocks moved by a correction, as by :meth:`moved`."""
        ...

    def in_samples(self, block: Any) -> list[Any]:
        """Return the samples of blocks as blocks of one sample each."""
        ...

    @property
    def angle_rows(self) -> tuple[int, ...]:
        """Rows of what it measures of itself that are angles, the same after a turn."""
        ...

    def measured(self, belief: AnyBelief, block: Any) -> Measured:
        """Return what the vehicle measures of itself at the ends of blocks."""
        ...

    def antenna(self, belief: AnyBelief, block: Any, delay: Tensor) -> Antenna:
        """Return where the antenna was ``delay`` seconds before the ends of blocks."""
        ...

    def moved(self, belief: AnyBelief, correction: Tensor, block: Any) -> AnyBelief:
        """Return a belief moved by a correction, shape (..., n); its covariance stays."""
        ...

    def difference(self, belief: AnyBelief, other: AnyBelief, block: Any) -> Tensor:
        """Return minus the correction by which ``moved`` leads from ``belief`` to ``other``."""
        ...

    def opened(self, verdict: Tensor, found: Measured, innovation: Tensor) -> Tensor:
        """Return the variance added where the gate resets one of its own kinds, shape (..., n)."""
        ...

    def passes(self, start: AnyBelief, line: VehicleLine) -> VehiclePasses[AnyBelief] | None:
        """Return the passes of the fast form over drives; None where the vehicle has none.

        Args:
            start: Belief before the first block, batch shape (B,).
            line: The drives in blocks.
        """
        ...

    def path(self, start: AnyBelief, after: AnyBelief, line: VehicleLine) -> Trajectory | InsState:
        """Return the causal solution at full rate, batch shape (B, T).

        Args:
            start: Belief before the first block, batch shape (B,).
            after: Belief after each block, batch shape (B, K).
            line: The drives in blocks.
        """
        ...


def blocks_in_turn(vehicle: Vehicle[Any], line: VehicleLine) -> list[Any]:
    """Return the blocks of drives one after another, batch shape (B,) each.

    Args:
        vehicle: The vehicle.
        line: The drives in blocks.
    """
    # unbound at once: picking blocks one by one would make the backward pass quadratic
    return unstacked(vehicle.all_blocks(line))


def no_fixes(timing: FixTiming) -> GnssFix:
    """Return fixes that tell nothing, at given moments.

    Args:
        timing: The moments, shape (B, M) each.
    """
    return GnssFix(*(torch.zeros_like(timing.delay) for _ in GnssFix._fields))
