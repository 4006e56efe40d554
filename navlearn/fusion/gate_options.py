"""When a filter believes a measurement, and how much."""

import math
from dataclasses import dataclass
from typing import Literal

from navlearn.errors import ConfigError

ROBUST = ("none", "huber", "student")
REFERENCES = ("odometer", "none")


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """When a measurement is refused, and when it counts for less.

    A position fix is asked in turn how far it is from the prediction, how it has moved since an
    earlier fix, and for its NIS; its verdict names the first that refuses it. All other kinds are
    asked for their NIS alone.

    Attributes:
        probability: Share of good measurements that pass the χ² gate; 1 switches it off.
        reset_after: After so many refusals in a row of one kind, for whatever reason, the next is
            taken, with a covariance opened to its innovation, so that a drifted filter cannot
            lock itself out.
        reset_azimuth: Azimuth deviation added at such a reset, rad.
        prediction_limit: T_RISS of [Ghouneem2024] Eq. (24): a position fix further than this
            from its prediction, horizontally, is refused, m; infinite switches the test off.
        motion_limit: T_GNSS of the same: a position fix that has moved by this much otherwise
            than it should have since an earlier fix is refused, m; infinite switches the test off.
        motion_reference: What a fix should have moved: ``odometer``, what odometer and gyro say
            since the last fix that this test believed; ``none``, nowhere since the fix before,
            as printed, which refuses every fast drive and the first good fix after an outlier.
        motion_growth: What the way since the earlier fix adds to ``motion_limit``, m per m, with
            the odometer as reference: by what share odometer and gyro may be wrong.
        robust: ``none`` takes what is believed as its variance says; ``huber`` and ``student``
            give it a larger variance the further it is from the prediction.
        robust_limit: Deviation of a single good measurement beyond which Huber's weight falls, in
            standard deviations; for a kind of several rows, the NIS that as many good ones exceed.
        freedom: Degrees of freedom of Student's distribution; fewer mistrust outliers more.
    """

    probability: float = 0.999
    reset_after: int = 10
    reset_azimuth: float = math.radians(10.0)
    prediction_limit: float = math.inf
    motion_limit: float = math.inf
    motion_reference: Literal["odometer", "none"] = "odometer"
    motion_growth: float = 0.05
    robust: Literal["none", "huber", "student"] = "none"
    robust_limit: float = 1.345
    freedom: float = 4.0

    def __post_init__(self) -> None:
        """Refuse what no gate can do.

        Raises:
            ConfigError: If an option is unknown or outside its range.
        """
        if not 0.0 < self.probability <= 1.0:
            raise ConfigError(
                f"GateOptions.probability: found {self.probability}; expected in (0, 1]"
            )
        for name, unit in (("prediction_limit", "m"), ("motion_limit", "m")):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"GateOptions.{name}: found {getattr(self, name)}; expected more than 0 "
                    f"{unit}, or .inf for no limit"
                )
        for name in ("robust_limit", "freedom"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(
                    f"GateOptions.{name}: found {getattr(self, name)}; expected a finite value > 0"
                )
        for name in ("reset_after", "reset_azimuth", "motion_growth"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(
                    f"GateOptions.{name}: found {getattr(self, name)}; expected a finite value >= 0"
                )
        for name, known in (("motion_reference", REFERENCES), ("robust", ROBUST)):
            if getattr(self, name) not in known:
                raise ConfigError(
                    f"GateOptions.{name}: found {getattr(self, name)!r}; choose among "
                    f"{', '.join(known)}"
                )

    @property
    def tests_motion(self) -> bool:
        """Whether any fix can be refused for how it moved."""
        return self.motion_limit < math.inf

    @property
    def tests_position(self) -> bool:
        """Whether a threshold in metres can refuse any fix."""
        return self.tests_motion or self.prediction_limit < math.inf

    @property
    def weighs(self) -> bool:
        """Whether what is believed may count for less than its variance says."""
        return self.robust != "none"
