"""The door through which drives come to a full-IMU filter, and by which histories leave."""

from collections.abc import Callable

from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.batch_axis import first, unsqueezed
from navlearn.fusion.drives import Method as Method
from navlearn.fusion.ins.checks import check_ins_history, check_ins_inputs
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.timeline import InsTimeline, ins_timeline
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

RunInsFilter = Callable[[InsBelief, InsTimeline, Method], InsHistory]
"""A filter over drives in blocks, whose inputs have been looked at."""


def filtered_ins_drives(
    model: InsFilterModel,
    run: RunInsFilter,
    start: InsBelief,
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    method: Method,
) -> InsHistory:
    """Run a filter over drives, with what comes in and what goes out looked at.

    Args:
        model: The filter.
        run: Its run over drives laid out in blocks.
        start: Belief before the first sample, batch shape (B,) or ().
        samples: Samples, shape (B, T) or (T,) each, vectors (B, T, 3) or (T, 3).
        fixes: GNSS solutions, shape (B, M) or (M,) each; M may be 0.
        timing: Where they fall among the samples.
        method: Form of the filter.

    Returns:
        History; without batch axis where the input had none.

    Raises:
        ConfigError: If the method is unknown.
        ShapeError: If a tensor has the wrong shape or type.
        LogError: If samples or fixes are not finite, not in SI units or hold what no drive can
            (see :mod:`navlearn.fusion.bounds`), or fixes are out of order or range.
        FilterDivergedError: If a state or variance is lost on the way.
    """
    if method not in ("exact", "fast", "sequential"):
        raise ConfigError(f"filter: found method {method!r}; choose exact, fast or sequential")
    if samples.dt.dim() == 1:
        batched = filtered_ins_drives(
            model,
            run,
            map_ins_belief(start, unsqueezed),
            ImuSample(*map(unsqueezed, samples)),
            GnssFix(*map(unsqueezed, fixes)),
            FixTiming(*map(unsqueezed, timing)),
            method,
        )
        return _without_batch(batched)
    if samples.dt.dim() != 2 or samples.dt.shape[-1] == 0:
        raise ShapeError(
            f"filter: samples have shape {tuple(samples.dt.shape)}; expected (B, T) or (T,) "
            "with at least one sample"
        )
    check_ins_inputs(model, start, samples, fixes, timing)
    history = run(start, ins_timeline(model, samples, fixes, timing), method)
    check_ins_history(model, history, samples)
    return history


def _without_batch(history: InsHistory) -> InsHistory:
    return history._replace(
        end=history.end[0],
        fix=history.fix[0],
        prior=map_ins_belief(history.prior, first),
        belief=map_ins_belief(history.belief, first),
        trajectory=InsState(*map(first, history.trajectory)),
        innovation=history.innovation[0],
        nis=history.nis[0],
        verdict=history.verdict[0],
        resets=history.resets[0],
        error=history.error[0],
    )
