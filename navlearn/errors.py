"""The errors that navlearn raises on purpose.

Each is also the built-in error that a caller would expect, so ``except ValueError`` works.
Messages say where, what was found, what was expected, and what to do.
"""


class NavlearnError(Exception):
    """Base of every error that navlearn raises on purpose."""


class LogError(NavlearnError, ValueError):
    """A drive log cannot be used as it is."""


class LogNotFoundError(NavlearnError, FileNotFoundError):
    """A file or folder that was named does not exist."""


class ConfigError(NavlearnError, ValueError):
    """A recipe, spec, descriptor or option has a wrong or unknown entry."""


class ShapeError(NavlearnError, ValueError):
    """A tensor has the wrong shape, type or order of axes."""


class FilterDivergedError(NavlearnError, ArithmeticError):
    """A filter's covariance or state is no longer finite or positive."""


class FitError(NavlearnError, RuntimeError):
    """An error model could not be fitted to the data it was given."""


class OutputExistsError(NavlearnError, FileExistsError):
    """Something would be overwritten; nothing was."""


class MissingExtraError(NavlearnError, ImportError):
    """An optional dependency is needed for what was asked."""
