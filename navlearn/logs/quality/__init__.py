"""Quality of a drive log: what is wrong with it, and what it tells about its sensors."""

from navlearn.logs.quality.calibration import (
    Calibration,
    estimate_calibration,
    gnss_latency,
    gyro_bias_at_rest,
    gyro_bias_from_turns,
    odometer_latency,
    odometer_scale,
)
from navlearn.logs.quality.check import check_log
from navlearn.logs.quality.findings import Finding, QualityReport
from navlearn.logs.quality.latency import Estimate, Latency, latency_between

__all__ = [
    "Calibration",
    "Estimate",
    "Finding",
    "Latency",
    "QualityReport",
    "check_log",
    "estimate_calibration",
    "gnss_latency",
    "gyro_bias_at_rest",
    "gyro_bias_from_turns",
    "latency_between",
    "odometer_latency",
    "odometer_scale",
]
