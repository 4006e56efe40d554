"""A method and the processor time that it takes."""

import time
from collections.abc import Sequence
from typing import Any

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import sees_after
from navlearn.outages.replay import BatchMethod, Method, Solution
from navlearn.outages.schedule import Outage


class TimedMethod:
    """A method and the processor time that it took."""

    def __init__(self, method: Method) -> None:
        """Wrap a method.

        Args:
            method: The method; what it may see after an outage stays the same.
        """
        self.method = method
        self.sees_after = sees_after(method)
        self.spent: dict[float, float] = {}

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the method's solution.

        Args:
            log: What the method may know.
            outage: The outage.
        """
        before = time.process_time()
        try:
            return self.method.predict(log, outage)
        finally:
            self.spent[outage.start] = time.process_time() - before


class TimedBatchMethod(TimedMethod):
    """A method that takes several outages at once; each counts for its share of the time."""

    def predict_many(self, logs: Sequence[DriveLog], outages: Sequence[Outage]) -> list[Solution]:
        """Return the method's solutions.

        Args:
            logs: What the method may know, per outage.
            outages: The outages.
        """
        before = time.process_time()
        many: Any = self.method
        made: list[Solution] = many.predict_many(logs, outages)
        each = (time.process_time() - before) / len(outages)
        self.spent |= {outage.start: each for outage in outages}
        return made


def timed(method: Method) -> TimedMethod:
    """Return a method that notes its processor time, several outages at once where it can.

    Args:
        method: The method.
    """
    return TimedBatchMethod(method) if isinstance(method, BatchMethod) else TimedMethod(method)
