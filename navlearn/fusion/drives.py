"""The door through which drives come to a RISS filter, and by which histories leave."""

from collections.abc import Callable
from typing import Literal

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.belief import Belief, map_belief
from navlearn.fusion.batch_axis import unsqueezed
from navlearn.fusion.checks import check_history, check_inputs
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.history import FilterHistory, history_without_batch
from navlearn.fusion.timeline import Timeline, timeline
from navlearn.states import FixTiming, GnssFix, RissSample

Method = Literal["exact", "fast", "sequential"]

RunFilter = Callable[[Belief, Timeline, Method], FilterHistory]
"""A filter over drives in blocks, whose inputs have been looked at."""


def filtered_drives(
    model: FilterModel,
    run: RunFilter,
    start: Belief,
    samples: RissSample,
    fixes: GnssFix,
    timing: FixTiming,
    method: Method,
) -> FilterHistory:
    """Run a filter over drives, with what comes in and what goes out looked at.

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
    if method not in ("exact", "fast", "sequential"):
        raise ConfigError(f"filter: found method {method!r}; choose exact, fast or sequential")
    if samples.dt.dim() == 1:
        batched = filtered_drives(
            model,
            run,
            map_belief(start, unsqueezed),
            RissSample(*map(unsqueezed, samples)),
            GnssFix(*map(unsqueezed, fixes)),
            FixTiming(*map(unsqueezed, timing)),
            method,
        )
        return history_without_batch(batched)
    if samples.dt.dim() != 2 or samples.dt.shape[-1] == 0:
        raise ShapeError(
            f"filter: samples have shape {tuple(samples.dt.shape)}; expected (B, T) or (T,) "
            "with at least one sample"
        )
    check_inputs(model, start, samples, fixes, timing)
    history = run(start, timeline(model, samples, fixes, timing), method)
    check_history(model, history, samples)
    return history
