"""The door through which drives come to a filter, and by which histories leave."""

from collections.abc import Callable
from typing import Any, Literal, TypeVar

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.belief import Belief
from navlearn.filters.tight_belief import map_tree
from navlearn.fusion.batch_axis import first, unsqueezed
from navlearn.fusion.checks import check_history, check_inputs
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.timeline import Timeline, timeline
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample

Method = Literal["exact", "fast", "sequential"]

RunFilter = Callable[[Belief, Timeline, Method], FilterHistory]
"""A filter over drives in blocks, whose inputs have been looked at."""

AnyHistory = TypeVar("AnyHistory")


def filtered_drives(
    model: FilterModel,
    run: RunFilter,
    start: Belief,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    method: Method,
) -> FilterHistory:
    """Run a RISS filter over drives, with what comes in and what goes out looked at.

    Args:
        model: The filter.
        run: Its run over drives laid out in blocks.
        start: Belief before the first sample, batch shape (B,) or ().
        samples: Samples, shape (B, T) or (T,) each.
        fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
        timing: Where they fall among the samples.
        method: Form of the filter.

    Returns:
        History; without batch axis where the input had none.

    Raises:
        ConfigError: If the method is unknown.
        ShapeError: If a tensor has the wrong shape or type.
        LogError: If samples or fixes are not finite or hold what no drive can (see
            :mod:`navlearn.fusion.bounds`), or fixes are out of order or range.
        FilterDivergedError: If a state or variance is lost on the way.
    """

    def looked_at(
        start: Belief, samples: RissSample, fixes: GnssFix, timing: FixTiming
    ) -> FilterHistory:
        check_inputs(model, start, samples, fixes, timing)
        history = run(start, timeline(model, samples, fixes, timing), method)
        check_history(model, history, samples)
        return history

    return over_batch(looked_at, start, samples, fixes, timing, method)


def over_batch(
    run: Callable[..., AnyHistory],
    start: Any,
    samples: RissSample | ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    method: Method,
) -> AnyHistory:
    """Run a filter over a batch of drives, or over one as a batch of one.

    Args:
        run: Takes start, samples, fixes and timing with a batch axis; gives a history.
        start: Belief before the first sample, batch shape (B,) or ().
        samples: Samples, batch shape (B, T) or (T,).
        fixes: GNSS solutions, shape (B, M) or (M,) each.
        timing: Where they fall among the samples.
        method: Form of the filter.

    Returns:
        History; without batch axis where the input had none.

    Raises:
        ConfigError: If the method is unknown.
        ShapeError: If samples have another number of axes, or there is none.
    """
    if method not in ("exact", "fast", "sequential"):
        raise ConfigError(f"filter: found method {method!r}; choose exact, fast or sequential")
    given = (start, samples, fixes, timing)
    alone = samples.dt.dim() == 1
    batch = map_tree(given, unsqueezed) if alone else given
    if batch[1].dt.dim() != 2 or batch[1].dt.shape[-1] == 0:
        raise ShapeError(
            f"filter: samples have shape {tuple(samples.dt.shape)}; expected (B, T) or (T,) "
            "with at least one sample"
        )
    history = run(*batch)
    return map_tree(history, first) if alone else history
