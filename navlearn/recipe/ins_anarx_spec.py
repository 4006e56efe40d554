"""Spec of ANARX on the position error of a full-IMU navigator: as printed, and soundly."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.spec_base import (
    Count,
    NotNegative,
    Positive,
    SafeguardSpec,
    Seed,
    SpecBase,
)

if TYPE_CHECKING:
    from navlearn.error_models.anarx_options import AnarxOptions
    from navlearn.learning.options import TrainingOptions

PAPER_INPUTS: Final = ("ins_position", "gnss_position", "delay_steps")
"""P_INS, P_GPS held since the last fix, d: names of :mod:`navlearn.learning.position_series`."""

SOUND_INPUTS: Final = ("forward_speed", "turned_speed", "delayed_speed")
"""How fast errors of an odometer, of a gyro's scale and of its bias carry a car away."""

MARGIN: Final = 0.25
"""Least improvement that the gate asks for."""

JARADAT2017: Final[dict[str, Any]] = {
    "training": "open_loop",
    "split": "random",
    "inputs": PAPER_INPUTS,
    "lags": 2,
    "hidden": 10,
    "linear_path": False,
    "max_iterations": 100,
    "patience": 6,
    "starts": 1,
    "ridge": 1e-6,
    "window_s": 200.0,
}
"""What takes the place of the defaults, which are those of the sound mode, in the paper's."""


class InsAnarxSpec(SpecBase):
    """An ANARX network on the position error of a free INS, or of the filter's coast.

    Keys left out are those of the ``mode``.

    Attributes:
        type: Kind of model.
        safeguard: When a correction is trusted. The gate asks for more than elsewhere: a filter
            that hears odometer and axle leaves so little that a useless model gains a tenth or
            two on the dozen emulated outages of its last minutes now and then.
        mode: ``paper``: [Jaradat2017], a network per Earth-fixed axis on the position error of a
            free-running INS. ``sound``: increments of the error of the filter's coast along and
            across, from emulated outages.
        training: ``open_loop`` feeds measured outputs back (series-parallel), ``closed_loop`` the
            network's own (parallel), as it runs through an outage.
        split: ``random`` rows, as the paper has them: neighbours leak, so it exists in its mode
            alone. ``time``: one part after the other, with the recipe's ``training.gap_s``
            between.
        inputs: Regressors beside the network's own past outputs. ``paper``: any of
            ``ins_position``, ``gnss_position``, ``delay_steps``. ``sound``: any of
            :data:`navlearn.learning.ins_regressors.INS_CHANNELS`.
        targets: ``interpolated`` scores every INS step, the target lying on straight lines
            between fixes; ``at_fixes`` scores rows at fixes alone. Mode ``paper`` only.
        lags: Number of lags, each with a sub-network of its own.
        hidden: Hidden units of each lag's sub-network.
        activation: Hidden activation.
        linear_path: Whether each lag also has a direct linear term.
        max_iterations: Upper bound of Levenberg-Marquardt iterations.
        patience: Iterations without a better validation loss before training stops.
        starts: Random starts of which the best goes on.
        ridge: Penalty on the mean square of the weights.
        window_s: How long before the outage the free INS starts, and what it learns from begins;
            null for the whole past. Mode ``paper`` only.
        seed: Seed of the initial weights, and of a random split.
    """

    type: Literal["ins_anarx"] = "ins_anarx"
    safeguard: SafeguardSpec = SafeguardSpec(gate_margin=MARGIN)
    mode: Literal["paper", "sound"] = "sound"
    training: Literal["open_loop", "closed_loop"] = "closed_loop"
    split: Literal["random", "time"] = "time"
    inputs: Annotated[tuple[str, ...], Field(min_length=1)] = SOUND_INPUTS
    targets: Literal["interpolated", "at_fixes"] = "interpolated"
    lags: Count = 1
    hidden: Count = 3
    activation: Literal["sigmoid", "tanh"] = "sigmoid"
    linear_path: bool = True
    max_iterations: Count = 60
    patience: Count = 10
    starts: Count = 2
    ridge: NotNegative = 300.0
    window_s: Positive | None = None
    seed: Seed = 0

    @model_validator(mode="before")
    @classmethod
    def _as_in_the_paper(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        return {**JARADAT2017, **content} if content.get("mode") == "paper" else content

    @model_validator(mode="after")
    def _options_go_together(self) -> "InsAnarxSpec":
        known = self.known_inputs()
        for name in self.inputs:
            if name not in known:
                raise ValueError(
                    f"unknown input {name!r} of mode {self.mode}{nearest_hint(name, known)}; "
                    f"known: {', '.join(known)}"
                )
            if self.inputs.count(name) > 1:
                raise ValueError(f"the input {name!r} is listed twice; list each once")
        if self.mode == "sound":
            self._nothing_of_the_paper()
        self.anarx_options(outputs=1)
        self.training_options()
        return self

    def _nothing_of_the_paper(self) -> None:
        if self.split == "random":
            raise ValueError(
                "split 'random' leaks between neighbours and exists in mode 'paper' alone; take "
                "'time'"
            )
        if self.targets != "interpolated" or self.window_s is not None:
            raise ValueError(
                "targets and window_s belong to mode 'paper'; what mode 'sound' learns from is "
                "told by the recipe's training section"
            )

    def known_inputs(self) -> tuple[str, ...]:
        """Return the names that ``inputs`` may hold in this mode."""
        if self.mode == "paper":
            return PAPER_INPUTS
        from navlearn.learning.ins_regressors import INS_CHANNELS

        return tuple(INS_CHANNELS)

    def anarx_options(self, *, outputs: int) -> "AnarxOptions":
        """Return the options of a network.

        Args:
            outputs: Number of outputs.
        """
        from navlearn.error_models.anarx_options import AnarxOptions

        return AnarxOptions(
            inputs=len(self.inputs),
            outputs=outputs,
            lags=self.lags,
            hidden=self.hidden,
            activation=self.activation,
            linear_path=self.linear_path,
            safeguard=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
        )

    def training_options(self) -> "TrainingOptions":
        """Return the options of its training: increments count by their sum, positions do not."""
        from navlearn.learning.options import TrainingOptions

        closed = self.training == "closed_loop"
        names = (field.name for field in dataclasses.fields(TrainingOptions))
        shared = {name: getattr(self, name) for name in names if name in type(self).model_fields}
        return TrainingOptions(
            loop="closed" if closed else "open",
            objective="accumulated" if closed and self.mode == "sound" else "step",
            **shared,
        )

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        loop = self.training.replace("_", " ")
        if self.mode == "paper":
            return (
                "a free-running INS with the position error that ANARX, one network per "
                f"Earth-fixed axis, adds to it ({loop} in training, {self.split} split, closed "
                "loop in use)"
            )
        return (
            "the full-IMU filter, its coast through the outage less what ANARX predicts of its "
            f"error along and across ({loop} in training, inputs {', '.join(self.inputs)})"
        )

    @property
    def seeds(self) -> dict[str, int]:
        """Seed of the initial weights."""
        return {self.name: self.seed}
