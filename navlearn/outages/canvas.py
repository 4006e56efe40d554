"""Figures without global state: the object API of matplotlib, and one look for all of them.

matplotlib is an optional dependency and is imported only when a figure is asked for. Colours
are those of Okabe and Ito, told apart by all kinds of colour vision.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from navlearn.errors import MissingExtraError
from navlearn.outages.roles import ORACLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Dash = str | tuple[float, tuple[float, ...]]

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#B5478D", "#E69F00", "#56B4E9", "#8C6D31", "#6A3D9A")
DASHES: tuple[Dash, ...] = ("-", (0.0, (6.0, 1.8)), (0.0, (6.0, 1.5, 1.5, 1.5)), (0.0, (2.2, 1.0)))
GREYS = ("#4D4D4D", "#7F7F7F", "#A6A6A6")
INK = "#333333"
REFERENCE = "#000000"
FIX = "#9AA5B1"
ROAD = "#C3CAD2"
DOTS_PER_INCH = 130


def plots_possible() -> bool:
    """Return whether matplotlib is installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        return False
    return True


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure that belongs to nobody else.

    Args:
        width: Inches.
        height: Inches.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError(
            "figures need matplotlib, which is not installed: pip install 'navlearn[report]'"
        ) from error
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(figure: "Figure", path: Path) -> Path:
    """Write a figure as PNG.

    Args:
        figure: The figure.
        path: The file to write.
    """
    figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})
    return path


def styles(methods: Iterable[str]) -> dict[str, tuple[str, Dash]]:
    """Return colour and dash of each method, the same in every figure of a run.

    Oracles are grey and dashed: they are bounds, not competitors.

    Args:
        methods: Names, in the run's order.
    """
    names = list(methods)
    competing = [name for name in names if name not in ORACLES]
    oracles = [name for name in ORACLES if name in names]
    look: dict[str, tuple[str, Dash]] = {}
    for k, name in enumerate(competing):
        # A second round of the colours has other dashes than the first.
        turn = k + k // len(PALETTE)
        look[name] = (PALETTE[k % len(PALETTE)], DASHES[turn % len(DASHES)])
    for k, name in enumerate(oracles):
        look[name] = (GREYS[k % len(GREYS)], DASHES[1 + k % (len(DASHES) - 1)])
    return {name: look[name] for name in names}


def logarithmic(axes: "Axes") -> None:
    """Make the horizontal axis logarithmic, labelled with plain numbers.

    Args:
        axes: The axes.
    """
    axes.set_xscale("log")
    _plain_numbers(axes.xaxis)


def logarithmic_up(axes: "Axes", lowest: float) -> None:
    """Make the vertical axis logarithmic, labelled with plain numbers.

    Args:
        axes: The axes.
        lowest: Where the axis begins at the lowest.
    """
    axes.set_yscale("log")
    axes.set_ylim(bottom=max(axes.get_ylim()[0], lowest))
    _plain_numbers(axes.yaxis)


def _plain_numbers(axis: "Axis") -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def tidy(axes: "Axes", xlabel: str = "", ylabel: str = "") -> None:
    """Give axes their labels with units, a light grid and no box.

    Args:
        axes: The axes.
        xlabel: Quantity and unit.
        ylabel: Quantity and unit.
    """
    axes.set_xlabel(xlabel, color=INK)
    axes.set_ylabel(ylabel, color=INK)
    axes.grid(visible=True, color="#E3E6EA", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#B0B7BF")
