"""Noise of a filter by maximum likelihood of its innovations, on drives without reference.

[Mehra1970] asks what noise the innovations speak of; here their likelihood is made large by
gradient through the filter. The search goes in rounds. Within one the gate's verdicts are held,
so that the likelihood is smooth; the first believes everything, as a filter that starts with
noise far too small would refuse what it has to learn from; each later one takes the verdicts of
the filter's own gate. Refusing earns nothing, as refused measurements are counted too.
"""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torch import Tensor
from tqdm import tqdm

from navlearn.errors import ConfigError, FilterDivergedError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.checkpointing import claim_checkpoint, read_checkpoint, write_checkpoint
from navlearn.learning.drive_likelihood import DriveLikelihood, TuningDrive
from navlearn.learning.noise_figures import NoiseFigures, noise_figures
from navlearn.learning.noise_objective import NoiseObjective
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import FreeParameters, default_names
from navlearn.learning.quasi_newton import Point, first_inverse, quasi_newton_step
from navlearn.mechanization.alignment import AlignmentOptions

CHECKPOINT = "noise_tuning.pt"


@dataclass(frozen=True, kw_only=True)
class TunedNoise:
    """What a search found.

    Attributes:
        options: The filter with its noise tuned.
        figures: What became of each free entry, and of what they make up.
        gain: By how much the log-likelihood of the tuning drives rose, nats, by the filter's
            own gate before and after.
        seconds: Length of the tuning drives, s.
        iterations: Steps taken.
        rounds: Rounds taken.
        converged: Whether the search ended by itself.
        wall: How long it took, s.
    """

    options: EkfOptions
    figures: NoiseFigures
    gain: float
    seconds: float
    iterations: int
    rounds: int
    converged: bool
    wall: float

    @property
    def values(self) -> dict[str, float]:
        """Values found, by name."""
        return {figure.name: figure.after for figure in self.figures.entries}


@dataclass
class _Search:
    """Where a search stands."""

    x: Tensor
    round_start: Tensor
    entered: float | None = None
    inverse: Tensor | None = None
    round: int = 0
    iteration: int = 0
    steps_in_round: int = 0
    done: bool = False


def tune_noise(
    drives: Sequence[TuningDrive],
    options: EkfOptions,
    tuning: TuningOptions | None = None,
    *,
    alignment: AlignmentOptions | None = None,
    folder: Path | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TunedNoise:
    """Tune a filter's noise on drives.

    Args:
        drives: Drives, or stretches of drives; what is not in them is not used.
        options: The filter to begin with, with closed feedback.
        tuning: How to search; None means the defaults.
        alignment: How the filter is started on a drive; None means the defaults.
        folder: Where to keep a checkpoint, so that an interrupted search can go on; None for
            nowhere.
        resume: Whether to go on from a checkpoint in that folder, if there is one.
        progress: Whether to show a progress bar.

    Returns:
        The tuned filter, and what the drives told of each entry.

    Raises:
        ConfigError: No drive, open feedback, unknown names, or a checkpoint of another search.
        LogError: A drive cannot be aligned or has hardly any fix.
        FilterDivergedError: The filter is lost on a drive even as it is given.
        OutputExistsError: There is a checkpoint, and it is not to be gone on from.
    """
    begun = time.monotonic()
    tuning = tuning or TuningOptions()
    if not drives:
        raise ConfigError("tuning: found no drive; name one or more")
    if options.feedback != "closed":
        raise ConfigError(
            "tuning: found feedback 'open'; tune with feedback 'closed' and use its noise for both"
        )
    parameters = FreeParameters(options, tuning.free or default_names(options, tuning.spacing))
    ready = [DriveLikelihood(drive, options, alignment, tuning.spacing) for drive in drives]
    objective = NoiseObjective(ready, parameters, tuning)
    before = _own_likelihood(objective, parameters.start)
    mark = _fingerprint(drives, options, tuning)
    path = None if folder is None else claim_checkpoint(folder, CHECKPOINT, resume)
    search = _begun(path, mark, parameters.start)
    bar: tqdm[Any]
    with tqdm(
        total=tuning.iterations,
        initial=search.iteration,
        desc="tuning",
        unit="step",
        disable=not progress,
    ) as bar:
        _run(objective, search, path, mark, bar, begun)
    objective.judge(search.x)
    after = objective.likelihood(search.x)
    figures = noise_figures(objective, search.x)
    return TunedNoise(
        options=parameters.tuned(search.x),
        figures=figures,
        gain=after - before,
        seconds=sum(drive.seconds for drive in ready),
        iterations=search.iteration,
        rounds=search.round,
        converged=search.done,
        wall=time.monotonic() - begun,
    )


def _own_likelihood(objective: NoiseObjective, logs: Tensor) -> float:
    """Return the log-likelihood with the verdicts of the filter's own gate."""
    objective.judge(logs)
    return objective.likelihood(logs)


def _run(
    objective: NoiseObjective,
    search: _Search,
    path: Path | None,
    mark: str,
    bar: "tqdm[Any]",
    begun: float,
) -> None:
    tuning = objective.options
    while not search.done and search.round < tuning.rounds:
        point = _round_begun(objective, search)
        if search.entered is None:
            search.entered = point.value
        if search.inverse is None:
            search.inverse = first_inverse(point)
        # the first verdicts are only to get near
        most = 15 if search.round == 0 else tuning.iterations
        while search.steps_in_round < most:
            late = time.monotonic() - begun > 60.0 * tuning.minutes
            if late or search.iteration >= tuning.iterations:
                return
            step = quasi_newton_step(objective, point, search.inverse, tuning.longest_step)
            if step is None:
                break
            gained, point = point.value - step[0].value, step[0]
            search.x, search.inverse = point.x, step[1]
            search.iteration += 1
            search.steps_in_round += 1
            bar.update(1)
            bar.set_postfix(round=search.round + 1, gain=f"{search.entered - point.value:.1f}")
            if gained < tuning.tolerance:
                break
            _kept(path, mark, search)
        moved = float((search.x - search.round_start).abs().max())
        search.round += 1
        gained = search.entered - point.value
        search.done = search.round > 1 and (gained < 10.0 * tuning.tolerance or moved < 0.02)
        search.round_start, search.steps_in_round, search.entered = search.x, 0, None
        _kept(path, mark, search)


def _round_begun(objective: NoiseObjective, search: _Search) -> Point:
    """Take a round's verdicts, and return where the search stands in it."""
    if search.round == 0:
        objective.believe_all()
        point = objective(search.x)
        if point.value < float("inf"):
            return point
    objective.judge(search.round_start)
    point = objective(search.x)
    if not point.value < float("inf"):
        raise FilterDivergedError(
            "tuning: the filter does not settle on the drives with the noise to begin with; "
            "begin with larger noise"
        )
    return point


def _fingerprint(drives: Sequence[TuningDrive], options: EkfOptions, tuning: TuningOptions) -> str:
    """Return a digest of everything that decides the result, but how long it may take."""
    digest = hashlib.sha256()
    settings = asdict(tuning)
    for name in ("iterations", "minutes"):
        settings.pop(name)
    digest.update(repr((asdict(options), settings)).encode())
    for drive in drives:
        digest.update(repr((drive.lever_arm, drive.vertical_velocity)).encode())
        for part in (*drive.samples, *drive.fixes, *drive.timing):
            digest.update(repr(tuple(part.shape)).encode())
            digest.update(part.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _kept(path: Path | None, mark: str, search: _Search) -> None:
    if path is not None:
        write_checkpoint(path, {"fingerprint": mark, **vars(search)})


def _begun(path: Path | None, mark: str, start: Tensor) -> _Search:
    if path is None or not path.exists():
        return _Search(start, start)
    content = read_checkpoint(path, mark, otherwise=f"delete {path.parent} to start anew")
    content.pop("fingerprint")
    return _Search(**content)
