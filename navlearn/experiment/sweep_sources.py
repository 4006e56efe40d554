"""What the drives of a sweep are made of, looked at before anything is run."""

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.range_fixes import with_fixes
from navlearn.experiment.sensors_needed import check_sensors
from navlearn.experiment.sweep_drives import real_drive
from navlearn.outages.placement import place_outages
from navlearn.outages.schedule import UNSCORED
from navlearn.outages.store import log_fingerprint
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import DegradedDrives, RecordedDrives

Sources = dict[tuple[int, float], str]
"""Hash of the real log behind a drive (empty for simulated ones), by its number or seed and the
length of outages; a drive into which no outage of a length fits is not there."""


def sources_of(recipe: SweepRecipe) -> tuple[Sources, tuple[str, ...]]:
    """Return what a sweep's drives are made of, and what of them is left out.

    Args:
        recipe: The sweep.

    Returns:
        The sources; and a sentence for every real drive that is left out at some length, and for
        every outage of one that was placed but cannot be scored.

    Raises:
        LogNotFoundError: A real drive does not exist.
        LogError: It cannot be used, or no outage fits anywhere.
        ConfigError: Two real drives have one name.
    """
    sweep = recipe.sweep
    if isinstance(sweep, RecordedDrives):
        return _recorded(recipe, sweep)
    source = log_fingerprint(real_drive(recipe)) if isinstance(sweep, DegradedDrives) else ""
    return {(seed, span): source for seed in sweep.seeds for span in sweep.durations_s}, ()


def _recorded(recipe: SweepRecipe, sweep: RecordedDrives) -> tuple[Sources, tuple[str, ...]]:
    sources, left_out, names, unscored = Sources(), list[str](), list[str](), list[str]()
    for number in sweep.seeds:
        log = real_drive(recipe, number)
        check_sensors(recipe.for_drive(log.metadata.name, sweep.durations_s[0]), log)
        if log.metadata.name in names:
            raise ConfigError(
                f"{recipe.name}: two of its logs are named {log.metadata.name!r}; list each drive "
                "once, or give their descriptors names of their own"
            )
        names.append(log.metadata.name)
        source = log_fingerprint(log)
        drive = with_fixes(log, recipe)
        for span in sweep.durations_s:
            try:
                placed = place_outages(recipe.for_drive("real", span).outages.protocol(), drive)
            except LogError as problem:
                left_out.append(f"{span:g} s, {problem}")
            else:
                sources[number, span] = source
                unscored += [
                    f"{log.metadata.name}, {one.start:.0f} to {one.end:.0f} s: {one.reason}"
                    for one in placed.excluded
                    if one.reason.startswith(UNSCORED)
                ]
    if not sources:
        raise LogError("no outage fits into any of the drives: " + "; ".join(left_out))
    told = (f"left out, because no outage fits: {one}" for one in left_out)
    return sources, (*told, *unscored)
