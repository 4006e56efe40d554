"""Tables that papers print, shown beside ours: to read, never to compare by machine."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from navlearn.errors import ConfigError
from navlearn.outages.markdown import markdown_table


@dataclass(frozen=True, kw_only=True)
class PublishedTable:
    """A table of a paper.

    Attributes:
        source: The paper's key in ``docs/references.bib``.
        caption: What the table shows, and where in the paper it stands.
        columns: Names of the columns, with units.
        rows: Cells of every line: words, or numbers as printed; as many as there are columns.
        remark: How far it may be compared with ours, such as "another drive, other sensors: the
            two do not compare".

    Raises:
        ConfigError: There is no column, or a row has more or fewer cells than there are columns.
    """

    source: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]
    remark: str = ""

    def __post_init__(self) -> None:
        if not self.columns:
            raise ConfigError(f"published table of {self.source}: no columns; name at least one")
        for number, cells in enumerate(self.rows, start=1):
            if len(cells) != len(self.columns):
                raise ConfigError(
                    f"published table of {self.source}: row {number} has {len(cells)} cells, but "
                    f"there are {len(self.columns)} columns; give every row a cell for each of "
                    f"{list(self.columns)}"
                )


def published_section(tables: Sequence[PublishedTable]) -> list[str]:
    """Return the tables of papers as Markdown, none where there are none.

    Args:
        tables: The tables.
    """
    if not tables:
        return []
    one_paper = len({one.source for one in tables}) == 1
    out = ["\n## The paper's table\n" if one_paper else "\n## The papers' tables\n"]
    for one in tables:
        remark = f" *{one.remark.rstrip('.')}.*" if one.remark else ""
        out.append(f"**[{one.source}]** {one.caption.rstrip('.')}.{remark}\n")
        out.append(markdown_table(one.columns, [[_cell(value) for value in r] for r in one.rows]))
    return out


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    # As printed: neither more digits than the paper has nor a ".0" that it has not.
    return f"{value:.10g}".replace("-", "−") if math.isfinite(value) else "–"
