"""What a sweep tells its report: its cells, its methods, what each cost, and what failed."""

import json
from collections.abc import Sequence

import pandas as pd

from navlearn.experiment.summary import filter_and_training, tuned_with
from navlearn.experiment.sweep_drives import gyro_class
from navlearn.experiment.sweep_jobs import CPU, Failure
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.jaradat2017 import GRADE as SCENARIO_GRADE
from navlearn.outages.cells import KEYS
from navlearn.outages.naming import counted
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.sweep_summary import SweepCell, SweepSummary
from navlearn.recipe.fixed_methods import FIXED_METHODS
from navlearn.recipe.log_section import SCENARIO
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import RECORDED, RecordedDrives, ScenarioDrives, SimulatedDrives


def sweep_summary(
    recipe: SweepRecipe,
    rows: pd.DataFrame,
    failures: Sequence[Failure],
    left_out: Sequence[str] = (),
) -> SweepSummary:
    """Return everything that the report of a sweep tells, but how it was run.

    Args:
        recipe: The sweep.
        rows: Rows of all drives that could be run.
        failures: What could not.
        left_out: What of real drives is left out, a sentence each.
    """
    sweep = recipe.sweep
    return SweepSummary(
        title=recipe.name,
        question=recipe.question,
        rows=rows,
        cells=_cells(recipe, rows),
        methods={name: _method(recipe, name, rows) for name in recipe.methods},
        command="",
        versions={},
        seeds={"recipe": recipe.seed}
        | {key: seed for spec in recipe.models for key, seed in spec.seeds.items()},
        classes={gyro_class(grade): _words(grade) for grade in sweep.grades},
        remarks=(*recipe.remarks, _origin(recipe), *_failed(failures)),
        published=tuple(one.table() for one in recipe.published),
        metric=recipe.metric,
        baseline=next(iter(recipe.baselines), "ekf"),
        also_against=recipe.baselines[1:2],
        setup=(
            f"outages: {recipe.outages.count} per drive and length, placed by "
            f"`{recipe.outages.placement}`, none before {recipe.outages.warm_up_s:g} s",
            *_satellites(recipe, rows),
            *filter_and_training(recipe.for_drive("any", sweep.durations_s[0])),
            *_filters_of_grades(recipe),
            *_clocks(recipe),
            *left_out,
        ),
    )


def _satellites(recipe: SweepRecipe, rows: pd.DataFrame) -> tuple[str, ...]:
    """Return by which rule satellites stay, nothing where none does."""
    most, rules = max(recipe.sweep.satellites), recipe.outages
    if most == 0:
        return ()
    return (
        f"satellites: those that stay are chosen by `{rules.visible}` among those in the last "
        f"reception before an outage that stand {rules.min_elevation_deg:g}° high or more and are "
        f"in at least {100.0 * rules.min_tracked:g} % of the receptions through it; scored are the "
        f"outages in which {most} could stay, the same ones for every number: {_scored(rows)}",
    )


def _scored(rows: pd.DataFrame) -> str:
    """Return how many outages there are, by class and length."""
    outages = rows.drop_duplicates([*KEYS[:2], "drive", "outage"])
    return ", ".join(
        f"{len(part)} of {span:g} s in {gyro}"
        for (gyro, span), part in outages.groupby(list(KEYS[:2]), sort=False)
    )


def _filters_of_grades(recipe: SweepRecipe) -> tuple[str, ...]:
    """Return what the filter is told of each grade beyond what all have in common."""
    both = (("filter", recipe.filter_by_grade), ("full-IMU filter", recipe.ins_filter_by_grade))
    told = [
        f"{which}, {gyro_class(grade)}: {json.dumps(options)} as well, for every filter but "
        "those of gyro oracles"
        for which, by_grade in both
        for grade, options in by_grade.items()
    ]
    tuned = [
        f"{gyro_class(grade)}, {tuned_with(spec)}" for grade, spec in recipe.tuned_by_grade.items()
    ]
    return (*told, *tuned)


def _clocks(recipe: SweepRecipe) -> tuple[str, ...]:
    """Return what is done to the clocks of every drive, a sentence per latency."""
    asked = recipe.calibration
    return tuple(
        f"clocks: {name} is estimated on every drive from what lies before its first outage, where "
        "its log does not state it, and removed where it is clear of zero"
        if value == "estimate"
        else f"clocks: {name} {float(value):+.3f} s: as the recipe says"
        for name, value in (
            ("gnss_latency", asked.gnss_latency),
            ("odometer_latency", asked.odometer_latency),
        )
    )


def _cells(recipe: SweepRecipe, rows: pd.DataFrame) -> tuple[SweepCell, ...]:
    cells = []
    for grade in recipe.sweep.grades:
        for kind in recipe.conditions:
            mine = rows["gyro_class"] == gyro_class(grade)
            mine &= rows["duration_s"] == kind.duration
            mine &= rows["satellites"] == kind.satellites
            drives = tuple(str(name) for name in rows.loc[mine, "drive"].unique())
            if drives:
                cell = SweepCell(gyro_class=gyro_class(grade), drives=drives, **kind._asdict())
                cells.append(cell)
    return tuple(cells)


def _method(recipe: SweepRecipe, name: str, rows: pd.DataFrame) -> MethodSummary:
    spent = rows.loc[rows["method"] == name, CPU].dropna()
    notes = (f"{spent.mean():.2g} s of processor time per outage",) if len(spent) else ()
    if name in FIXED_METHODS:
        return MethodSummary(**FIXED_METHODS[name]._asdict(), notes=notes)
    spec = recipe.model(name)
    return MethodSummary(
        description=spec.describe(),
        regime=spec.regime,
        notes=notes,
        guarded=spec.safeguard.gate,
    )


def _words(grade: str) -> str:
    """Return what a grade stands for, without the class that it names itself."""
    if grade == RECORDED:
        return "drives as they were recorded"
    summary = (SCENARIO_GRADE if grade == SCENARIO else find_grade(grade)).summary
    return summary.partition(": ")[2] if summary.startswith("class ") else summary


def _origin(recipe: SweepRecipe) -> str:
    sweep = recipe.sweep
    if isinstance(sweep, RecordedDrives):
        made = (
            "; their fixes and odometer are made from their reference, with stated noise: semi-real"
            if any(sweep.source(number).aiding is not None for number in sweep.seeds)
            else ""
        )
        return f"{counted(sweep.drives, 'recorded drive')}{made}."
    first, last = sweep.seeds[0], sweep.seeds[-1]
    seeds = f"seeds {first} to {last}" if sweep.drives > 1 else f"seed {first}"
    if isinstance(sweep, ScenarioDrives):
        return f"Simulated: the scenario of [Jaradat2017] §IV, {sweep.drives} draws, {seeds}."
    if isinstance(sweep, SimulatedDrives):
        sky = "" if sweep.sky is None else f", ranges under the sky `{sweep.sky}`"
        return (
            f"Simulated drives: {sweep.drives} per class of {sweep.duration_s:g} s, profile "
            f"`{sweep.profile}`{sky}, {seeds}; the roads are the same for every class."
        )
    source = sweep.log.descriptor or sweep.log.path
    name = source.stem if source is not None else "a real drive"
    return (
        f"Semi-synthetic: the real drive {name} with the gyro error of each class added to its own "
        f"gyro, drawn with {seeds}. The drives of a class are one road, driven once."
    )


def _failed(failures: Sequence[Failure]) -> tuple[str, ...]:
    if not failures:
        return ()
    told = "; ".join(f"{one.where}: {one.reason}" for one in failures)
    return (f"**Not run** ({len(failures)}), and not in the figures: {told}.",)
