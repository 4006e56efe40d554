"""Tables and figures in Markdown."""

import math
from collections.abc import Mapping, Sequence


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]], *, texts: int = 1) -> str:
    """Return a Markdown table; the first columns are text, the others are figures.

    Args:
        header: Names of the columns.
        lines: Cells of every line.
        texts: How many columns are text.
    """
    rule = [*(["---"] * texts), *(["---:"] * (len(header) - texts))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (header, rule, *lines)) + "\n"


def number(value: object, digits: int = 2) -> str:
    """Return a figure with so many digits and a true minus, or a dash where there is none.

    Args:
        value: The figure.
        digits: After the point.
    """
    number = float(value)  # type: ignore[arg-type]
    return f"{number:.{digits}f}".replace("-", "−") if math.isfinite(number) else "–"


def signed(value: float) -> str:
    """Return a figure with its sign, a true minus, or a dash where there is none.

    Args:
        value: The figure.
    """
    if not math.isfinite(value):
        return "–"
    text = f"{value:+.1f}".replace("-", "−")
    return "0.0" if text[1:] == "0.0" else text


def one_line(title: str, entries: Mapping[str, object]) -> str:
    """Return names and values in one line behind a title.

    Args:
        title: What they are.
        entries: Values by name.
    """
    return f"**{title}.** {', '.join(f'{key} {value}' for key, value in entries.items())}.\n"
