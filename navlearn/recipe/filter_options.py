"""Overrides of the filters' options, checked against the options themselves."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from navlearn.recipe.overrides import built, checked_for

if TYPE_CHECKING:
    from navlearn.filters.unscented import UnscentedOptions
    from navlearn.fusion.ins.options import InsEkfOptions
    from navlearn.fusion.options import EkfOptions
    from navlearn.fusion.tight.options import TightEkfOptions


def checked_filter(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of filter options with every value of its field's type.

    Args:
        overrides: Values by name of a field of :class:`navlearn.fusion.options.EkfOptions`;
            groups such as ``noise`` are mappings themselves.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    if not overrides:
        return {}
    from navlearn.fusion.options import EkfOptions

    return checked_for(EkfOptions, overrides)


def checked_ins_filter(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of the full-IMU filter's options, as :func:`checked_filter` does.

    Args:
        overrides: Values by name of a field of
            :class:`navlearn.fusion.ins.options.InsEkfOptions`.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    if not overrides:
        return {}
    from navlearn.fusion.ins.options import InsEkfOptions

    return checked_for(InsEkfOptions, overrides)


def checked_tight(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of the tightly coupled filter's options, as :func:`checked_filter` does.

    Args:
        overrides: Values by name of a field of
            :class:`navlearn.fusion.tight.options.TightEkfOptions`.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    if not overrides:
        return {}
    from navlearn.fusion.tight.options import TightEkfOptions

    return checked_for(TightEkfOptions, overrides)


def checked_unscented(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of the sigma points' options, as :func:`checked_filter` does.

    Args:
        overrides: Values by name of a field of
            :class:`navlearn.filters.unscented.UnscentedOptions`.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    if not overrides:
        return {}
    from navlearn.filters.unscented import UnscentedOptions

    return checked_for(UnscentedOptions, overrides)


def checked_integrity(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of the gate's options, as :func:`checked_filter` does.

    Args:
        overrides: Values by name of a field of :class:`navlearn.fusion.gate_options.GateOptions`.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    if not overrides:
        return {}
    from navlearn.fusion.gate_options import GateOptions

    return checked_for(GateOptions, overrides)


def ekf_options(overrides: Mapping[str, Any]) -> "EkfOptions":
    """Return the filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_filter` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.options import EkfOptions

    made: EkfOptions = built(EkfOptions, overrides)
    return made


def ins_ekf_options(overrides: Mapping[str, Any]) -> "InsEkfOptions":
    """Return the full-IMU filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_ins_filter` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.ins.options import InsEkfOptions

    made: InsEkfOptions = built(InsEkfOptions, overrides)
    return made


def tight_ekf_options(overrides: Mapping[str, Any]) -> "TightEkfOptions":
    """Return the tightly coupled filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_tight` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.tight.options import TightEkfOptions

    made: TightEkfOptions = built(TightEkfOptions, overrides)
    return made


def unscented_options(overrides: Mapping[str, Any]) -> "UnscentedOptions":
    """Return the sigma points' options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_unscented` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.filters.unscented import UnscentedOptions

    made: UnscentedOptions = built(UnscentedOptions, overrides)
    return made
