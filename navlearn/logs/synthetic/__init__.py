"""Synthetic drives: profiles, error-free sensors by inverse mechanization, sensor grades."""

from navlearn.logs.synthetic.degrade import degrade_gyro
from navlearn.logs.synthetic.fault_options import Biases, FaultOptions, Freezes, Ramps, Spikes
from navlearn.logs.synthetic.faults import with_faults
from navlearn.logs.synthetic.figures import SensorGrade
from navlearn.logs.synthetic.grades import GRADES
from navlearn.logs.synthetic.jaradat2017 import jaradat2017_scenario
from navlearn.logs.synthetic.recorded import motion_from_trajectory
from navlearn.logs.synthetic.satellite_options import PRESETS, SatelliteOptions
from navlearn.logs.synthetic.semi_real import with_aiding_from_reference
from navlearn.logs.synthetic.semi_real_ranges import with_simulated_ranges
from navlearn.logs.synthetic.simulate import simulate_drive
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive
from navlearn.logs.synthetic.sky_noise import noise_of_sky

__all__ = [
    "GRADES",
    "PRESETS",
    "Biases",
    "FaultOptions",
    "Freezes",
    "Ramps",
    "SatelliteOptions",
    "SensorGrade",
    "SimulatedDrive",
    "Spikes",
    "degrade_gyro",
    "jaradat2017_scenario",
    "motion_from_trajectory",
    "noise_of_sky",
    "simulate_drive",
    "with_aiding_from_reference",
    "with_faults",
    "with_simulated_ranges",
]
