"""The small drive that ships in ``datasets/``: made here, so that anybody can make it again.

``python -m navlearn.logs.synthetic.sample FOLDER`` writes it. Values are rounded to what such
sensors resolve, which keeps the files small; the reference is rounded to a millimetre.
"""

import sys
from pathlib import Path

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive

SEED = 5
DURATION = 1980.0
"""s."""

DECIMALS = {
    "t": 3,
    "gyro_x": 5,
    "gyro_y": 5,
    "gyro_z": 5,
    "accel_x": 3,
    "accel_y": 3,
    "accel_z": 3,
    "temperature": 1,
    "speed": 3,
    "lat": 10,
    "lon": 10,
    "height": 3,
    "v_e": 3,
    "v_n": 3,
    "v_u": 3,
    "std_e": 2,
    "std_n": 2,
    "std_u": 2,
    "std_v": 3,
    "satellites": 0,
    "azimuth": 5,
    "pitch": 5,
    "roll": 5,
}
"""Decimals kept of each column, SI and radians; 1e-10 rad of latitude are 0.6 mm."""


def sample_drive() -> SimulatedDrive:
    """Return the sample drive before rounding: 33 minutes of town, suburb and motorway."""
    return simulate_drive(
        profile="commute",
        grade="mems_x",
        duration=DURATION,
        seed=SEED,
        imu_rate_hz=10.0,
        odometer_rate_hz=10.0,
        fix_rate_hz=1.0,
        reference_rate_hz=1.0,
        standstill=60.0,
        name="sample_drive",
    )


def rounded(log: DriveLog) -> DriveLog:
    """Return the log with its columns rounded to :data:`DECIMALS`."""
    tables = {
        name: table.round({str(c): DECIMALS[str(c)] for c in table})
        for name, table in log.tables().items()
    }
    return log.with_tables(tables)


def make_sample_drive(folder: Path | str, *, force: bool = False) -> Path:
    """Write the sample drive in navlearn's own form.

    Args:
        folder: Where to; made where it does not exist.
        force: Whether an earlier log there may be replaced.

    Returns:
        The folder.

    Raises:
        OutputExistsError: The folder already holds a log.
    """
    return save_log(rounded(sample_drive().log), folder, force=force)


def main(arguments: list[str]) -> int:
    """Write the sample drive into the folder that the command line names."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        sys.stderr.write("usage: python -m navlearn.logs.synthetic.sample FOLDER\n")
        return 2
    make_sample_drive(arguments[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
