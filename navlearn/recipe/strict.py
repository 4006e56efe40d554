"""Strict sections: unknown keys are refused, and every refusal says where and what is allowed."""

import inspect
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from navlearn.errors import ConfigError
from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.yaml_file import KeyPath, YamlFile

S = TypeVar("S", bound="Section")


class Section(BaseModel):
    """Base of every section: frozen, and without keys of one's own invention."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="constants"
    )


def parse(section: type[S], content: Mapping[str, Any], *, file: YamlFile | str) -> S:
    """Return a section made of plain values.

    Args:
        section: The class to make.
        content: Its keys and values.
        file: Where they were read, or words that say where they came from.

    Raises:
        ConfigError: Something is unknown, missing or wrong; every finding is listed.
    """
    try:
        return section.model_validate(content)
    except ValidationError as problem:
        findings = [_finding(section, details, file) for details in problem.errors()]
        raise ConfigError("\n".join(dict.fromkeys(findings))) from None


def _finding(section: type[Section], details: ErrorDetails, file: YamlFile | str) -> str:
    key_path = _untagged(section, tuple(details["loc"]))
    where = file if isinstance(file, str) else file.where(key_path)
    return f"{where}: {_explain(section, key_path, details)}"


def _explain(section: type[Section], key_path: KeyPath, details: ErrorDetails) -> str:
    name = _dotted(key_path)
    kind, value = details["type"], details["input"]
    if kind == "extra_forbidden":
        known = _known_keys(section, tuple(details["loc"])[:-1])
        place = f" in {_dotted(key_path[:-1])}" if key_path[:-1] else ""
        key = str(key_path[-1])
        return f"unknown key {key!r}{place}{nearest_hint(key, known)}; known: {', '.join(known)}"
    if kind == "missing":
        return f"the key {name!r} is missing; it must be given"
    context = details.get("ctx", {})
    if kind == "union_tag_invalid":
        tag, known = str(context["tag"]), _quoted(str(context["expected_tags"]))
        return (
            f"{name}.type is {tag!r}; expected one of {', '.join(known)}{nearest_hint(tag, known)}"
        )
    if kind == "literal_error":
        hint = nearest_hint(str(value), _quoted(str(context["expected"])))
        return f"{name} is {value!r}; expected {context['expected']}{hint}"
    if kind == "value_error":
        said = str(context["error"])
        return f"{name}: {said}" if name else said
    wanted = details["msg"].replace("Input should be ", "expected ")
    return f"{name} is {value!r}; {wanted}"


def _quoted(text: str) -> list[str]:
    return text.split("'")[1::2]


def _dotted(key_path: KeyPath) -> str:
    parts = [f"[{key}]" if isinstance(key, int) else f".{key}" for key in key_path]
    return "".join(parts).removeprefix(".")


def _known_keys(section: type[Section], key_path: KeyPath) -> list[str]:
    """Return the keys of the section that a path leads to."""
    candidates = [section]
    for key in key_path:
        if isinstance(key, int):
            continue
        tagged = [one for one in candidates if len(candidates) > 1 and _tag_of(one) == key]
        candidates = tagged or _sections_in(candidates[0].model_fields[key].annotation)
    return list(candidates[0].model_fields)


def _untagged(section: type[Section], key_path: KeyPath) -> KeyPath:
    """Return a path without the tags by which unions of sections are told apart."""
    candidates, kept = [section], list[str | int]()
    for key in key_path:
        if isinstance(key, int):
            kept.append(key)
            continue
        tagged = [one for one in candidates if len(candidates) > 1 and _tag_of(one) == key]
        if tagged:
            candidates = tagged
            continue
        kept.append(key)
        field = next((one.model_fields[key] for one in candidates if key in one.model_fields), None)
        candidates = _sections_in(field.annotation) if field is not None else []
    return tuple(kept)


def _tag_of(section: type[Section]) -> str | None:
    field = section.model_fields.get("type")
    return None if field is None else str(typing.get_args(field.annotation)[0])


def _sections_in(annotation: Any) -> list[type[Section]]:
    """Return the sections that a field's type holds, looking into lists and unions."""
    if inspect.isclass(annotation) and issubclass(annotation, Section):
        return [annotation]
    return [found for inner in typing.get_args(annotation) for found in _sections_in(inner)]
