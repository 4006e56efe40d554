"""Range-error models as methods: the tight filter on ranges less what a model says of them.

Source: [Iqbal2020] §IX. Up to the outage the filter runs on all satellites and leaves residuals,
which the model learns; through the outage what it predicts is taken off the ranges of the
satellites that stay, before the filter takes them. With none that stays, or where the gate refuses
the model, the solution is that of ``tc_ekf`` to the last digit.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.error_models.fos import FosModel
from navlearn.error_models.safeguard import GateVerdict
from navlearn.errors import FilterDivergedError, FitError
from navlearn.experiment.gate_notes import gate_notes
from navlearn.experiment.learned import Learned
from navlearn.experiment.range_error_correction import Corrected, corrected
from navlearn.experiment.range_error_gate import judged, past_of
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.experiment.tight_method import heard, tight_table
from navlearn.learning.range_record import range_record
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.range_error_spec import RangeErrorSpec


class RangeErrorMethod:
    """The tightly coupled filter with a model of range errors through partial outages.

    The standard deviations are those of the filter: its noise allows for range errors that the
    model makes smaller, not provably so.
    """

    def __init__(
        self,
        runs: TightFilterRuns,
        spec: RangeErrorSpec,
        keep: Callable[[str, Learned], None] | None = None,
    ) -> None:
        """Make a method of a model.

        Args:
            runs: Filter runs, shared with the other methods.
            spec: The model.
            keep: Called with the model's name, satellite added, and each fit, before its solution
                is returned.
        """
        self.runs, self.spec, self.keep = runs, spec, keep

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the filter's solution through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start, and from there
                without ranges but those of the satellites that stay visible.
            outage: The outage.
        """
        start = self.runs.before(log, outage)
        plain = start.through()
        names = start.series.satellites
        visible = torch.tensor([name in outage.satellites_visible for name in names])
        try:
            solved_by(self.spec, visible)
            past = past_of(start)
            after = range_record(plain, start.ranges, start.received)
            found = corrected(
                past.record,
                after,
                outage.start,
                start.ranges,
                visible,
                self.spec,
                start.navigator.options.tight.range_noise,
                logs=(log.metadata.name,),
            )
            verdict = judged(start, past, visible, self.spec)
        except (FitError, FilterDivergedError) as problem:
            notes = {"used": False, "fitted": False, "reason": str(problem)}
            return Solution(table=tight_table(start, plain, outage), notes=notes)
        self._kept(found, verdict, names)
        history = start.through(found.ranges) if verdict.use else plain
        notes = {
            **gate_notes(verdict, self.spec.safeguard, used=verdict.use),
            **_notes(found, names),
            **heard(start, history),
        }
        return Solution(table=tight_table(start, history, outage), notes=notes)

    def _kept(self, found: Corrected, verdict: GateVerdict, names: tuple[str, ...]) -> None:
        if self.keep is None:
            return
        taught = [name for name, k in zip(names, found.errors.taught.tolist(), strict=True) if k]
        for k, fitted in enumerate(found.errors.fitted):
            own = "" if self.spec.shared else f"_{taught[k]}"
            learned = Learned(
                fitted=fitted,
                verdict=verdict,
                example=found.errors.inputs[k],
                trial=fitted.record,
            )
            self.keep(f"{self.spec.name}{own}", learned)


def solved_by(spec: RangeErrorSpec, visible: Tensor) -> None:
    """Refuse where nothing is left to correct, or enough is left to do without.

    Args:
        spec: The model.
        visible: Satellites that stay, bool, shape (S,).

    Raises:
        FitError: If that is so.
    """
    count = int(visible.sum())
    if count == 0:
        raise FitError("no satellite stays, so there is no range to correct")
    if count >= spec.min_satellites:
        raise FitError(
            f"{count} satellites stay and solve for position and clock; the model acts below "
            f"{spec.min_satellites}"
        )


def _notes(found: Corrected, names: tuple[str, ...]) -> dict[str, object]:
    known, fitted = found.errors.known, found.errors.fitted
    notes: dict[str, object] = {
        "fitted": True,
        "satellites_corrected": " ".join(
            name for name, k in zip(names, known.tolist(), strict=True) if k
        ),
        "largest_correction_m": float(found.correction.abs().max()),
        "inputs_outside_training": found.errors.outside,
    }
    if fitted:
        notes["training_rows"] = sum(one.record.samples for one in fitted)
        notes["terms"] = sum(one.record.iterations for one in fitted)
    if fitted and isinstance(fitted[0].model, FosModel):
        source = fitted[0].record.source
        notes["equation"] = fitted[0].model.equation(source.inputs, "range_error")
    return notes
