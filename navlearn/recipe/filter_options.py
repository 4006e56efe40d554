"""Overrides of the filter's options, checked against the options themselves."""

import dataclasses
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from navlearn.logs.nearest import nearest_hint

if TYPE_CHECKING:
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

    return _checked_for(EkfOptions, overrides)


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

    return _checked_for(InsEkfOptions, overrides)


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

    return _checked_for(TightEkfOptions, overrides)


def _checked_for(options: type[Any], overrides: dict[str, Any]) -> dict[str, Any]:
    checked = _checked(options, overrides, prefix="")
    _built(options, checked)
    return checked


def ekf_options(overrides: Mapping[str, Any]) -> "EkfOptions":
    """Return the filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_filter` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.options import EkfOptions

    built: EkfOptions = _built(EkfOptions, overrides)
    return built


def ins_ekf_options(overrides: Mapping[str, Any]) -> "InsEkfOptions":
    """Return the full-IMU filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_ins_filter` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.ins.options import InsEkfOptions

    built: InsEkfOptions = _built(InsEkfOptions, overrides)
    return built


def tight_ekf_options(overrides: Mapping[str, Any]) -> "TightEkfOptions":
    """Return the tightly coupled filter's options with overrides laid over their defaults.

    Args:
        overrides: As :func:`checked_tight` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    from navlearn.fusion.tight.options import TightEkfOptions

    built: TightEkfOptions = _built(TightEkfOptions, overrides)
    return built


def _checked(options: type[Any], overrides: Mapping[str, Any], *, prefix: str) -> dict[str, Any]:
    wanted = typing.get_type_hints(options)
    known = [field.name for field in dataclasses.fields(options)]
    checked: dict[str, Any] = {}
    for name, value in overrides.items():
        if name not in known:
            raise ValueError(
                f"unknown key {prefix + str(name)!r}{nearest_hint(str(name), known)}; "
                f"known: {', '.join(known)}"
            )
        if dataclasses.is_dataclass(wanted[name]):
            if not isinstance(value, Mapping):
                raise ValueError(f"{prefix}{name} is {value!r}; expected a mapping of options")
            group = typing.cast("type[Any]", wanted[name])
            checked[name] = _checked(group, value, prefix=f"{prefix}{name}.")
        else:
            checked[name] = _converted(prefix + name, value, wanted[name])
    return checked


def _converted(name: str, value: Any, wanted: Any) -> Any:
    try:
        return TypeAdapter(wanted).validate_python(value)
    except ValidationError as problem:
        said = problem.errors()[0]["msg"].replace("Input should be ", "expected ")
        raise ValueError(f"{name} is {value!r}; {said}") from None


def _built(options: type[Any], overrides: Mapping[str, Any]) -> Any:
    """Return options with overrides; mappings of numbers are laid over their defaults too."""
    wanted = typing.get_type_hints(options)
    default = options()
    values: dict[str, Any] = {}
    for name, value in overrides.items():
        if dataclasses.is_dataclass(wanted[name]):
            values[name] = _built(typing.cast("type[Any]", wanted[name]), value)
        elif isinstance(value, Mapping):
            values[name] = {**getattr(default, name), **value}
        else:
            values[name] = value
    return dataclasses.replace(default, **values)
