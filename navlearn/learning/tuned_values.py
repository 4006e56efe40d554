"""What any rule of tuning finds: values, figures and notes, which a tuned spec is made of."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class TunedValues:
    """Options of a filter that a rule found.

    Attributes:
        filter: Overrides of :class:`navlearn.fusion.options.EkfOptions`, or of
            :class:`navlearn.fusion.ins.options.InsEkfOptions`, by name.
        figures: Numbers worth knowing, by name.
        notes: What a reader should know.
    """

    filter: dict[str, Any]
    figures: dict[str, int | float | dict[str, int | float]]
    notes: tuple[str, ...] = ()
