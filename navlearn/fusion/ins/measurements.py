"""The kinds of measurement that a full-IMU filter takes, and the rows each has."""

from enum import IntEnum

from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.measurements import Rows, rows_of


class InsKind(IntEnum):
    """Kinds of measurement, in the order of every per-kind axis."""

    POSITION = 0
    VELOCITY = 1
    ODOMETER = 2
    NONHOLONOMIC = 3
    ZERO_VELOCITY = 4
    ZERO_YAW_RATE = 5


def ins_rows(options: InsEkfOptions) -> Rows:
    """Return the rows that a filter's measurements take.

    Standstill says nothing about gyro errors to a filter without gyro states but how the car is
    tilted against the Earth's rate, which no car's gyro resolves: 9 states take no rate at rest.

    Args:
        options: Choices of the filter.

    Returns:
        Rows.
    """
    has_bias = options.states > 9
    wanted = (
        (InsKind.POSITION, options.position, 3),
        (InsKind.VELOCITY, options.velocity, 3 if options.vertical_velocity else 2),
        (InsKind.ODOMETER, options.odometer, 1),
        (InsKind.NONHOLONOMIC, options.nonholonomic, 2),
        (InsKind.ZERO_VELOCITY, options.zero_velocity, 3),
        (InsKind.ZERO_YAW_RATE, options.zero_angular_rate and has_bias, 3),
    )
    return rows_of(wanted, len(InsKind))
