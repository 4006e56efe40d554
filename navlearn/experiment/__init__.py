"""Experiments: recipe to log, fit, replay and report."""

from navlearn.experiment.run import RunResult, run_recipe
from navlearn.experiment.train import train_recipe

__all__ = ["RunResult", "run_recipe", "train_recipe"]
