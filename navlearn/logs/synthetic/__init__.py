"""Synthetic drives: profiles, error-free sensors by inverse mechanization, sensor grades."""

from navlearn.logs.synthetic.grades import GRADES, SensorGrade
from navlearn.logs.synthetic.simulate import SimulatedDrive, simulate_drive

__all__ = ["GRADES", "SensorGrade", "SimulatedDrive", "simulate_drive"]
