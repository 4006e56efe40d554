"""Figures by their column names in words: what is measured, and in which unit."""

UNITS = {"_m_per_s": "m/s", "_percent": "% of distance", "_deg": "°", "_m": "m", "_s": "s"}
"""Unit by the ending of a column's name; without one a figure is a share or a count."""

_SHORT = {"max": "maximum", "rms": "RMS", "95": "95 %"}


def words_and_unit(metric: str) -> tuple[str, str]:
    """Return a column's name in words, and its unit (empty for shares and counts).

    Args:
        metric: Name of a column of ``outages.csv``.
    """
    for ending, unit in UNITS.items():
        if metric.endswith(ending):
            return _words(metric.removesuffix(ending)), unit
    return _words(metric), ""


def axis_label(metric: str) -> str:
    """Return what stands at an axis, such as ``maximum horizontal error (m)``.

    Args:
        metric: Name of a column of ``outages.csv``.
    """
    words, unit = words_and_unit(metric)
    return f"{words} ({unit})" if unit else words


def with_unit(value: float, metric: str) -> str:
    """Return a figure with its unit, such as ``3.94 m``.

    Args:
        value: The figure.
        metric: Name of its column.
    """
    return f"{value:.2f} {words_and_unit(metric)[1]}".rstrip()


def counted(count: int, what: str) -> str:
    """Return how many there are of something, such as ``1 outage`` and ``2 outages``.

    Args:
        count: How many.
        what: Of what; it takes an s where there are several.
    """
    return f"{count} {what}{'' if count == 1 else 's'}"


def _words(name: str) -> str:
    return " ".join(_SHORT.get(word, word) for word in name.split("_"))
