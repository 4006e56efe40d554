"""Mechanization: sensor samples become position, velocity and attitude."""

from navlearn.mechanization.options import RissOptions
from navlearn.mechanization.riss import RissMechanization, riss_step
from navlearn.mechanization.riss_parallel import riss_over_time

__all__ = ["RissMechanization", "RissOptions", "riss_over_time", "riss_step"]
