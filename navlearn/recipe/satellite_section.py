"""The satellites of a simulated drive: a preset's name, or options laid over a preset."""

import dataclasses
import typing
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, TypeAdapter, ValidationError

from navlearn.logs.nearest import nearest_hint

if TYPE_CHECKING:
    from navlearn.logs.synthetic import SatelliteOptions

PRESET: Final = "preset"
"""Key of a mapping that names what its other entries are laid over; ``open_sky`` if left out."""


def checked_satellites(given: str | dict[str, Any]) -> str | dict[str, Any]:
    """Return the satellites of a recipe with every value of its field's type.

    Args:
        given: Name of a preset, or values by name of a field of
            :class:`navlearn.logs.synthetic.SatelliteOptions`, and ``preset``.

    Raises:
        ValueError: A name is unknown or a value is not allowed.
    """
    from navlearn.logs.synthetic import SatelliteOptions

    if isinstance(given, str):
        satellite_options(given)
        return given
    wanted = typing.get_type_hints(SatelliteOptions)
    known = [PRESET, *(field.name for field in dataclasses.fields(SatelliteOptions))]
    checked: dict[str, Any] = {}
    for name, value in given.items():
        if name not in known:
            raise ValueError(
                f"unknown key {name!r}{nearest_hint(str(name), known)}; known: {', '.join(known)}"
            )
        checked[name] = _converted(name, value, str if name == PRESET else wanted[name])
    satellite_options(checked)
    return checked


def satellite_options(given: str | dict[str, Any]) -> "SatelliteOptions":
    """Return the options that a recipe's entry means.

    Args:
        given: As :func:`checked_satellites` returns it.

    Raises:
        ConfigError: No preset has the name, or a value is not allowed.
    """
    from navlearn.logs.synthetic.satellite_options import find_satellites

    if isinstance(given, str):
        return find_satellites(given)
    changed = {name: value for name, value in given.items() if name != PRESET}
    return dataclasses.replace(find_satellites(given.get(PRESET, "open_sky")), **changed)


def _converted(name: str, value: Any, wanted: Any) -> Any:
    try:
        return TypeAdapter(wanted).validate_python(value)
    except ValidationError as problem:
        said = problem.errors()[0]["msg"].replace("Input should be ", "expected ")
        raise ValueError(f"{name} is {value!r}; {said}") from None


Satellites = Annotated[str | dict[str, Any], AfterValidator(checked_satellites)]
"""Entry of a recipe."""
