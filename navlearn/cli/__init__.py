"""The command line: check, simulate, run, train, evaluate, export, predict."""

from navlearn.cli.app import app, main

__all__ = ["app", "main"]
