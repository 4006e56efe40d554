"""What only a simulation knows of its ranges, kept beside a log and never inside it.

Methods are handed a drive log; who judges an error model asks for this further table on demand,
so that no method can come upon it by accident.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.truth_file import read_truth, write_truth

RANGE_TRUTH: Final = "range_truth.csv.gz"
"""File in the folder of a log that navlearn simulated."""

COLUMNS: Final[dict[str, str]] = {
    "t": "reception, s from the start of the log",
    "satellite": "text: the satellite, such as G07",
    "range_error": "error of the pseudorange, all parts, m",
    "rate_error": "error of the range rate, m/s",
    "clock": "receiver clock, times the speed of light, without system_offset, m",
    "clock_rate": "its rate, m/s",
    "system_offset": "offset of the satellite's system against the first one's, m",
    "elevation": "true elevation, rad",
    "azimuth": "true azimuth, rad",
    "ionosphere": "part of range_error, m",
    "troposphere": "part of range_error, m",
    "orbit": "part of range_error: orbit and clock as broadcast, m",
    "multipath": "part of range_error: beside the direct signal, m",
    "reflection": "part of range_error: detour of a signal received by reflection alone, m",
    "thermal": "part of range_error: white noise, m",
    "systematic": "part of range_error: what elevation and C/N0 tell, m",
}
"""One row per row of the log's ranges."""


@dataclass(frozen=True, kw_only=True)
class RangeTruth:
    """The true errors of a log's ranges and its receiver's clock.

    A pseudorange is the distance of the satellite from the antenna + clock + system offset +
    error.

    Attributes:
        table: Columns of :data:`COLUMNS`, rows as in the log's ranges.
    """

    table: pd.DataFrame

    def of(self, log: DriveLog) -> "RangeTruth":
        """Return the rows of a log's ranges, which may be cut or partly withheld.

        Args:
            log: The drive that this was made with.

        Raises:
            LogError: The log has a range that is not here: it is another drive.
        """
        ranges = log.ranges if log.ranges is not None else self.table.iloc[:0]
        known = self.table.assign(key=_key(self.table["t"]))
        late = log.metadata.gnss_latency if log.metadata.latency_removed else 0.0
        # A latency that was taken off the log's times is put back, unless this was made without.
        for shift in (late, 0.0):
            wanted = ranges[["t", "satellite"]].assign(key=_key(ranges["t"] + shift))
            table = wanted.merge(
                known.drop(columns="t"), on=["key", "satellite"], how="left", validate="1:1"
            ).drop(columns="key")
            unknown = table["range_error"].isna().to_numpy()
            if not unknown.any():
                return RangeTruth(table=table[list(COLUMNS)])
        row = int(np.argmax(unknown))
        raise LogError(
            f"{log.metadata.name}: the truth of its ranges has no value for satellite "
            f"{table['satellite'].iloc[row]} at {table['t'].iloc[row]:g} s; it belongs to "
            "another drive: write log and truth together again"
        )

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Return a column of numbers.

        Args:
            name: One of :data:`COLUMNS` but the satellite.
        """
        return self.table[name].to_numpy(np.float64)


def _key(t: "pd.Series[float]") -> npt.NDArray[np.int64]:
    return np.asarray(np.rint(t.to_numpy(np.float64) * 1e6), dtype=np.int64)


def save_range_truth(truth: RangeTruth, folder: Path) -> Path:
    """Write the truth of ranges beside a log.

    Args:
        truth: The truth.
        folder: Folder of the log; a truth that is there is replaced.

    Returns:
        The file.
    """
    return write_truth(truth.table, folder / RANGE_TRUTH)


def load_range_truth(folder: Path) -> RangeTruth:
    """Read the truth of ranges that lies beside a log.

    Args:
        folder: Folder of the log.

    Raises:
        LogNotFoundError: There is none: the ranges are not simulated ones.
        LogError: The file cannot be used.
    """
    remedy = (
        "the true errors of ranges are known of simulated ones alone; make a drive with navlearn "
        "simulate --satellites"
    )
    return RangeTruth(table=read_truth(folder / RANGE_TRUTH, COLUMNS, remedy, texts="satellite"))
