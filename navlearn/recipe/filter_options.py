"""Overrides of the filter's options, checked against the options themselves."""

import dataclasses
import typing
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError

from navlearn.recipe.strict import nearest


def checked_filter(overrides: dict[str, Any]) -> dict[str, Any]:
    """Return overrides of filter options as values of their fields' types.

    Args:
        overrides: Values by name of a field of :class:`navlearn.fusion.EkfOptions`.

    Raises:
        ValueError: A name is unknown or a value does not fit its field.
    """
    if not overrides:
        return {}
    import navlearn.fusion

    options = getattr(navlearn.fusion, "EkfOptions", None)
    if options is None:
        return overrides
    types = typing.get_type_hints(options)
    known = [field.name for field in dataclasses.fields(options)]
    for name in overrides:
        if name not in known:
            raise ValueError(
                f"unknown key {name!r}{nearest(name, known)} (known: {', '.join(known)})"
            )
    return {name: _converted(name, value, types[name]) for name, value in overrides.items()}


def _converted(name: str, value: Any, wanted: Any) -> Any:
    adapter = TypeAdapter(wanted, config=ConfigDict(arbitrary_types_allowed=True))
    try:
        return adapter.validate_python(value)
    except ValidationError as problem:
        said = problem.errors()[0]["msg"].replace("Input should be ", "expected ")
        raise ValueError(f"{name} is {value!r}; {said}") from None
