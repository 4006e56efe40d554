"""What there is to measure at the end of a block, what of it a filter takes, and what comes of it.

:mod:`navlearn.fusion.updates` makes the one of the others.
"""

from typing import NamedTuple

from torch import Tensor

from navlearn.fusion.error_state import ErrorLayout
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.measurements import Rows
from navlearn.fusion.sensor_errors import SensorErrors
from navlearn.fusion.standstill import Rest
from navlearn.states import GnssFix


class Occasion(NamedTuple):
    """What there is to measure at the end of a block, shape (...) each.

    Attributes:
        fix: GNSS solution; ``has_position`` and ``has_velocity`` are 0 where none is.
        delay: End of the block minus the fix's time, s.
        end: Last sample of the block.
        rest: Standstill at the block's end.
        astray: 1.0 where the fix has moved otherwise than the car
            (:mod:`navlearn.fusion.motion_check`); None for nowhere.
    """

    fix: GnssFix
    delay: Tensor
    end: BlockEnd
    rest: Rest
    astray: Tensor | None = None


class Measured(NamedTuple):
    """Innovations of all kinds.

    Attributes:
        innovation: Measured minus predicted, shape (..., r).
        observation: H, shape (..., r, n).
        variance: Diagonal of R, shape (..., r).
        present: 1.0 where a kind is measured, shape (..., 5).
        extra: What a measurement that is not linear adds to R, a covariance over all rows, shape
            (..., r, r); None where H tells all.
        astray: 1.0 where the position has moved otherwise than the car, shape (...); None for
            nowhere.
    """

    innovation: Tensor
    observation: Tensor
    variance: Tensor
    present: Tensor
    extra: Tensor | None = None
    astray: Tensor | None = None


class MeasurementModel(NamedTuple):
    """All that the measurement functions need to know of a filter.

    Attributes:
        errors: Sensor parameters.
        layout: Order of the error states.
        rows: Rows of each kind.
        lever_arm: Antenna from the navigating point, body RFU, m, or None.
        earth_rate: Rotation rate of the Earth that the gyro senses, rad/s.
        course_speed: Slowest speed at which course is used, m/s.
        standstill: Shortest standstill that observes the gyro, s.
    """

    errors: SensorErrors
    layout: ErrorLayout
    rows: Rows
    lever_arm: tuple[float, float, float] | None
    earth_rate: float
    course_speed: float
    standstill: float
