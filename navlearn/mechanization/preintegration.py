"""Preintegration of a full IMU between two times: what a filter over windows needs.

``preintegrate`` sums up windows of samples whatever state they start from, all windows of a drive
at once; ``predict`` carries a state over a window; ``block_transition`` tells what becomes of its
errors. The three are written down in the files named after them.
"""

from navlearn.mechanization.preintegration_predict import corrected, predict
from navlearn.mechanization.preintegration_transition import block_transition
from navlearn.mechanization.preintegration_window import (
    Preintegrated,
    preintegrate,
    preintegrate_increments,
)

__all__ = [
    "Preintegrated",
    "block_transition",
    "corrected",
    "predict",
    "preintegrate",
    "preintegrate_increments",
]
