"""Mechanization: sensor samples become position, velocity and attitude."""

from navlearn.mechanization.inverse import inverse_riss
from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss import RissMechanization, riss_step
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.mechanization.tilt import TiltOptions, tilt_from_specific_force

__all__ = [
    "RissMechanization",
    "RissOptions",
    "TiltOptions",
    "inverse_riss",
    "riss_over_time",
    "riss_step",
    "tilt_from_specific_force",
]
