"""A tuned spec: options of a filter that were found, not chosen, and what they were found on."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from navlearn.errors import OutputExistsError
from navlearn.recipe.filter_options import checked_filter, checked_ins_filter
from navlearn.recipe.overrides import laid_over
from navlearn.recipe.spec_base import PlainName
from navlearn.recipe.strict import Section, parse
from navlearn.recipe.yaml_file import read_yaml, yaml_text


class TunedOn(Section):
    """A drive, or a stretch of one, that options were tuned on.

    Attributes:
        log: The log's name.
        fingerprint: Of the log's content, as :func:`navlearn.outages.store.log_fingerprint`
            tells it; empty where it is not known.
        from_s: Where the stretch begins, s; null for the log's beginning.
        until_s: Where it ends, s; null for the log's end.
    """

    log: str
    fingerprint: str = ""
    from_s: float | None = None
    until_s: float | None = None

    @model_validator(mode="after")
    def _in_order(self) -> "TunedOn":
        if self.from_s is not None and self.until_s is not None and self.until_s <= self.from_s:
            raise ValueError(
                f"until_s {self.until_s:g} is not later than from_s {self.from_s:g}; a stretch "
                "ends after it begins"
            )
        return self


class TunedSpec(Section):
    """What a recipe's filter is tuned with.

    Attributes:
        name: Short name, used in tables and for files.
        method: How the options were found: ``gradient`` (likelihood of the innovations),
            ``differences`` (increments of a reference against dead reckoning), ``ghouneem2024``
            (that paper's averages of differences), ``allan`` (a standstill), ``by_hand``.
        sensors: Which filter it belongs to: ``riss`` (a recipe's ``filter``) or ``imu`` (its
            ``ins_filter``).
        filter: Options of that filter, by name; groups such as ``noise`` are mappings.
        made_from: What it was tuned on. It proves nothing about those stretches.
        figures: Numbers worth knowing, by name; a value may be a mapping of numbers.
        notes: Anything a reader should know.
    """

    name: PlainName = "tuned"
    method: Literal["gradient", "differences", "ghouneem2024", "allan", "by_hand"] = "by_hand"
    sensors: Literal["riss", "imu"] = "riss"
    filter: dict[str, Any] = Field(min_length=1)
    made_from: tuple[TunedOn, ...] = ()
    figures: dict[str, int | float | dict[str, int | float]] = Field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @field_validator("filter")
    @classmethod
    def _of_the_filter(cls, overrides: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        check = checked_ins_filter if info.data.get("sensors") == "imu" else checked_filter
        return check(overrides)

    def laid_over(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """Return overrides of a filter's options with what was tuned in their place.

        Args:
            overrides: As a recipe's ``filter`` (``ins_filter`` where ``sensors`` is ``imu``)
                holds them. What was not tuned stays.
        """
        return laid_over(overrides, self.filter)


def read_tuned(path: str | Path) -> TunedSpec:
    """Read a tuned spec.

    Args:
        path: A YAML file.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="tuned spec")
    return parse(TunedSpec, file.content, file=file)


def write_tuned(path: str | Path, spec: TunedSpec, *, replace: bool = False) -> None:
    """Write a tuned spec; a reader finds the whole file or none.

    Args:
        path: The YAML file.
        spec: What to write.
        replace: Whether a file that is there may be replaced.

    Raises:
        OutputExistsError: There is such a file, and it may not be replaced; or a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputExistsError(f"{path}: is a folder; name a file, such as tuned.yaml")
    if path.exists() and not replace:
        raise OutputExistsError(f"{path}: exists; move it away, name another file, or force it")
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", text=True)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as part:
            part.write(yaml_text(spec.model_dump(mode="json")))
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
