"""Mechanization: sensor samples become position, velocity and attitude."""

from navlearn.mechanization.inverse import inverse_riss
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss import RissMechanization, riss_step
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.mechanization.strapdown import local_level_step, strapdown_in_turn
from navlearn.mechanization.strapdown_parallel import strapdown_over_time
from navlearn.mechanization.tilt import TiltOptions, tilt_from_specific_force

__all__ = [
    "RissMechanization",
    "RissOptions",
    "TiltOptions",
    "inverse_riss",
    "local_level_step",
    "riss_over_time",
    "riss_step",
    "strapdown_in_turn",
    "strapdown_over_time",
    "tilt_from_specific_force",
]
