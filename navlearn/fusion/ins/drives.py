"""The door through which drives come to a full-IMU filter, and by which histories leave."""

from collections.abc import Callable

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.drives import Method as Method
from navlearn.fusion.drives import over_batch
from navlearn.fusion.ins.checks import check_ins_history, check_ins_inputs
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.timeline import InsTimeline, ins_timeline
from navlearn.states import FixTiming, GnssFix, ImuSample

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
    """Run a full-IMU filter over drives, with what comes in and what goes out looked at.

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

    def looked_at(
        start: InsBelief, samples: ImuSample, fixes: GnssFix, timing: FixTiming
    ) -> InsHistory:
        check_ins_inputs(model, start, samples, fixes, timing)
        history = run(start, ins_timeline(model, samples, fixes, timing), method)
        check_ins_history(model, history, samples)
        return history

    return over_batch(looked_at, start, samples, fixes, timing, method)
