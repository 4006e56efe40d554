"""Writes all files of a finished replay into the folder of a run."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

from navlearn.outages.canvas import plots_possible
from navlearn.outages.maps import Scene, plot_drifts, plot_track
from navlearn.outages.output import OutputFolder
from navlearn.outages.plots import plot_distribution, plot_error_growth
from navlearn.outages.report import write_report
from navlearn.outages.run_summary import RunSummary
from navlearn.outages.sky import skies_of
from navlearn.outages.sky_plots import plot_skies
from navlearn.outages.tables import write_outages_csv, write_summary_json

MOST_DRIVES_DRAWN = 6


def write_results(output: OutputFolder, summary: RunSummary, scenes: Sequence[Scene]) -> RunSummary:
    """Write ``outages.csv``, ``summary.json``, the figures and ``report.md``.

    Without matplotlib the figures are left out, with a warning.

    Args:
        output: The run's folder.
        summary: The run; its figures are filled in here.
        scenes: One per drive.

    Returns:
        The summary with its figures.

    Raises:
        OutputExistsError: A file of that name exists which no run wrote.
    """
    write_outages_csv(output.claim("outages.csv"), summary.rows)
    if plots_possible():
        summary = replace(summary, figures=write_figures(output, summary, scenes))
    else:
        warnings.warn(
            "no figures were drawn: matplotlib is missing; pip install 'navlearn[report]'",
            stacklevel=2,
        )
    write_summary_json(output.claim("summary.json"), summary)
    write_report(output.claim("report.md"), summary)
    return summary


def write_figures(
    output: OutputFolder, summary: RunSummary, scenes: Sequence[Scene]
) -> dict[str, str]:
    """Draw the figures of a run.

    Args:
        output: The run's folder.
        summary: The run.
        scenes: One per drive; maps are drawn of the first :data:`MOST_DRIVES_DRAWN`.

    Returns:
        Captions by file name.
    """
    captions = {
        "error_growth.png": "Horizontal error through the outages: the line is the median over "
        "outages, the band reaches from quartile to quartile.",
        "distribution.png": f"`{summary.metric}` over outages. Left: a dot per outage; the box "
        "reaches from quartile to quartile, its bar is the median, whiskers reach to the farthest "
        "outage within one and a half boxes. Right: share of the outages below an error.",
    }
    plot_error_growth(output.claim("error_growth.png"), [scene.replay for scene in scenes])
    plot_distribution(output.claim("distribution.png"), summary.rows, summary.metric)
    for number, scene in enumerate(scenes[:MOST_DRIVES_DRAWN], start=1):
        ending = f"_{number}.png" if len(scenes) > 1 else ".png"
        name = scene.log.metadata.name
        plot_track(output.claim("track" + ending), scene)
        plot_drifts(output.claim("drifts" + ending), scene)
        captions["track" + ending] = f"Track of {name} with the outages and each method's drift."
        captions["drifts" + ending] = (
            f"Drift of each method through the outages of {name}, seen from where the car is (the "
            "cross): dots are the errors at the end, the grey sketch is the road, north up."
        )
        if any(outage.satellites_visible for outage in scene.outages):
            skies = skies_of(scene.log, scene.outages)
            plot_skies(output.claim("sky" + ending), skies, scene.outages)
            captions["sky" + ending] = (
                f"The sky over {name} at the last reception before each outage, the zenith in the "
                "middle, circles 30° apart: large and in colour the satellites that stay."
            )
    return captions
