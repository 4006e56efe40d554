"""YAML files that remember where each of their keys stands."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from navlearn.errors import ConfigError, LogNotFoundError

KeyPath = tuple[str | int, ...]


@dataclass(frozen=True, kw_only=True)
class YamlFile:
    """One mapping read from a file.

    Attributes:
        path: Where it was read.
        content: The mapping, as plain values.
        lines: Line of each key and list item, counted from 1, by its path.
    """

    path: Path
    content: dict[str, Any]
    lines: dict[KeyPath, int]

    def where(self, key_path: KeyPath) -> str:
        """Return file and line of a key, or of the nearest thing above it that is written."""
        for length in range(len(key_path), 0, -1):
            line = self.lines.get(key_path[:length])
            if line is not None:
                return f"{self.path}:{line}"
        return str(self.path)


def read_yaml(path: Path, *, what: str) -> YamlFile:
    """Read a YAML file that holds one mapping.

    Args:
        path: The file.
        what: What the file is meant to be, for messages: "recipe", "model spec".

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: The file is not YAML, holds no mapping, or names a key twice.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError):
        raise LogNotFoundError(f"{path}: there is no such {what} file; check the path") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: a {what} is a YAML text file; this one is not text") from None
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as problem:
        raise ConfigError(f"{path}: not valid YAML: {problem}") from None
    if root is None or not isinstance(content, dict):
        found = "nothing" if content is None else f"a {type(content).__name__}"
        raise ConfigError(f"{path}: a {what} is a YAML mapping of keys to values; found {found}")
    return YamlFile(path=path, content=content, lines=dict(_marks(root, path)))


def _marks(root: yaml.Node, path: Path) -> Iterator[tuple[KeyPath, int]]:
    """Yield the path and line of every key and item; refuse a key that stands twice."""
    pending: list[tuple[KeyPath, yaml.Node]] = [((), root)]
    seen_nodes: set[int] = set()
    while pending:
        prefix, node = pending.pop()
        if id(node) in seen_nodes:  # an alias may point back at what holds it
            continue
        seen_nodes.add(id(node))
        if isinstance(node, yaml.MappingNode):
            keys: set[str] = set()
            for key_node, value_node in node.value:
                key = str(key_node.value)
                line = key_node.start_mark.line + 1
                if key in keys:
                    raise ConfigError(f"{path}:{line}: the key {key!r} stands twice; keep one")
                keys.add(key)
                yield (*prefix, key), line
                pending.append(((*prefix, key), value_node))
        elif isinstance(node, yaml.SequenceNode):
            for index, item in enumerate(node.value):
                yield (*prefix, index), item.start_mark.line + 1
                pending.append(((*prefix, index), item))


def yaml_text(content: dict[str, Any]) -> str:
    """Return a mapping of plain values as YAML, its keys in their order.

    Args:
        content: Keys and values.
    """
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
