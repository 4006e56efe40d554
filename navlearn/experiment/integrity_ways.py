"""Ways to tell good fixes from bad ones that are compared with each other, and their limits.

The limits in metres were set on simulated drives alone (grade ``mems_m`` without outliers, seeds 11
to 16, an outage of 60 s every five minutes): each is the smallest of :data:`GRID` that refuses at
most one good fix in a thousand there, as the χ² gate is meant to. That of the printed test is set
without outages, of each of which it refuses the first fix after whatever the limit. Nothing was
changed after real drives had been looked at. ``as ghouneem2024_ukf`` is what the recipe of that
name states, set there on simulated drives with faults. What the limits were set by is printed by
``benchmarks/integrity_detection.py --limits``.
"""

from typing import Final

from navlearn.fusion.gate_options import GateOptions

GRID: Final = (1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0)
"""Limits that were tried, m."""

PREDICTION: Final = 7.0
"""How far a fix may be from the prediction, m."""

MOTION: Final = 4.0
"""How much otherwise than the odometer tells a fix may have moved, m."""

MOTION_AS_PRINTED: Final = 40.0
"""How far a fix may be from the one before it, m."""

OPEN: Final = GateOptions(probability=1.0)
"""A gate that lets everything pass."""

WAYS: Final[dict[str, GateOptions]] = {
    "no test": OPEN,
    "χ² gate": GateOptions(),
    "χ² gate, reset after 60": GateOptions(reset_after=60),
    "prediction limit": GateOptions(probability=1.0, prediction_limit=PREDICTION),
    "motion limit": GateOptions(probability=1.0, motion_limit=MOTION),
    "motion limit as printed": GateOptions(
        probability=1.0, motion_limit=MOTION_AS_PRINTED, motion_reference="none"
    ),
    "Huber": GateOptions(probability=1.0, robust="huber"),
    "Student": GateOptions(probability=1.0, robust="student"),
    "as ghouneem2024_ukf": GateOptions(prediction_limit=15.0, motion_limit=10.0, reset_after=30),
    "all together": GateOptions(prediction_limit=PREDICTION, motion_limit=MOTION, robust="huber"),
}
"""Options of the gate by way."""
