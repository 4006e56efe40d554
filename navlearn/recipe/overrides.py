"""Overrides of options by name: checked against the fields of the options, and laid over them."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from navlearn.logs.nearest import nearest_hint


def checked_for(options: type[Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return overrides with every value of its field's type.

    Args:
        options: A dataclass of options whose fields all have defaults.
        overrides: Values by name of a field; groups of options are mappings themselves.

    Raises:
        ValueError: A name is unknown, a value is not allowed, or the options do not go together.
    """
    checked = _checked(options, overrides, prefix="")
    built(options, checked)
    return checked


def built(options: type[Any], overrides: Mapping[str, Any]) -> Any:
    """Return options with overrides; mappings of numbers are laid over their defaults too.

    Args:
        options: A dataclass of options.
        overrides: As :func:`checked_for` returns them.

    Raises:
        ConfigError: The options do not go together.
    """
    wanted = typing.get_type_hints(options)
    default = options()
    values: dict[str, Any] = {}
    for name, value in overrides.items():
        group = group_of(wanted[name])
        if group is not None and isinstance(value, Mapping):
            values[name] = built(group, value)
        elif isinstance(value, Mapping):
            values[name] = {**getattr(default, name), **value}
        else:
            values[name] = value
    return dataclasses.replace(default, **values)


def laid_over(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return overrides with others laid over them, group by group.

    Args:
        common: The first ones.
        own: Those that win.
    """
    merged = dict(common)
    for name, value in own.items():
        below = merged.get(name)
        both = isinstance(value, Mapping) and isinstance(below, Mapping)
        merged[name] = laid_over(below, value) if both else value  # type: ignore[arg-type]
    return merged


def group_of(wanted: Any) -> type[Any] | None:
    """Return the options that a field holds, perhaps none of them; None for a plain value.

    Args:
        wanted: The field's type.
    """
    if isinstance(wanted, types.UnionType):
        inner = [one for one in typing.get_args(wanted) if one is not type(None)]
        return group_of(inner[0]) if len(inner) == 1 else None
    return wanted if isinstance(wanted, type) and dataclasses.is_dataclass(wanted) else None


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
        group = group_of(wanted[name])
        may_be_none = isinstance(wanted[name], types.UnionType)
        if group is None or (value is None and may_be_none):
            checked[name] = _converted(prefix + name, value, wanted[name])
        elif isinstance(value, Mapping):
            checked[name] = _checked(group, value, prefix=f"{prefix}{name}.")
        else:
            raise ValueError(f"{prefix}{name} is {value!r}; expected a mapping of options")
    return checked


def _converted(name: str, value: Any, wanted: Any) -> Any:
    try:
        return TypeAdapter(wanted).validate_python(value)
    except ValidationError as problem:
        said = problem.errors()[0]["msg"].replace("Input should be ", "expected ")
        raise ValueError(f"{name} is {value!r}; {said}") from None
