"""The files of a run that programs read: ``outages.csv`` and ``summary.json``."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from navlearn.errors import ConfigError
from navlearn.outages.acting import Acting, acting, reasons
from navlearn.outages.meaning import meaning, oracle_shares, run_warnings
from navlearn.outages.metrics import FIGURES
from navlearn.outages.oracle_share import OracleShare
from navlearn.outages.roles import role_of
from navlearn.outages.run_summary import DriveSummary, RunSummary, comparisons
from navlearn.outages.statistics import Comparison, averages

HEAD = ("drive", "method", "outage", "start_s", "duration_s", "dynamics", "distance_m")
SUMMARISED = tuple(name for name in FIGURES if "error" in name and "track" not in name)


def write_outages_csv(path: Path, rows: pd.DataFrame) -> Path:
    """Write the table of outages, a row per outage and method; figures to the last digit.

    Args:
        path: The file to write.
        rows: What replaying returned, of one or several drives.

    Raises:
        ConfigError: A column that readers of the file count on is missing.
    """
    missing = [name for name in dict.fromkeys(HEAD + FIGURES) if name not in rows.columns]
    if missing:
        raise ConfigError(f"{path.name}: the rows lack {missing}; take them from a replay")
    rest = [name for name in rows.columns if name not in HEAD]
    rows[[*HEAD, *rest]].to_csv(path, index=False, lineterminator="\n")
    return path


def write_summary_json(path: Path, summary: RunSummary) -> Path:
    """Write what a run found; unknown figures are null.

    Args:
        path: The file to write.
        summary: The run.
    """
    text = json.dumps(without_nan(summary_content(summary)), indent=2, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def summary_content(summary: RunSummary) -> dict[str, object]:
    """Return the content of ``summary.json``: keys may be added later, never renamed.

    Args:
        summary: The run.
    """
    versus = {baseline: comparisons(summary, baseline) for baseline in summary.baselines}
    shares = oracle_shares(summary)
    return {
        "title": summary.title,
        "question": summary.question,
        "remarks": list(summary.remarks),
        "command": summary.command,
        "versions": dict(summary.versions),
        "seeds": {**summary.seeds, "bootstrap": summary.bootstrap_seed},
        "protocol": asdict(summary.protocol),
        "drives": [_drive(drive) for drive in summary.drives],
        "metric": summary.metric,
        "baselines": list(summary.baselines),
        "methods": {
            name: _method(summary, name, versus, shares.get(name)) for name in summary.methods
        },
        "warnings": [line.replace("**", "") for line in run_warnings(summary)],
        "meaning": [line.replace("**", "") for line in meaning(summary)],
        "published": [asdict(one) for one in summary.published],
        "figures": dict(summary.figures),
    }


def _method(
    summary: RunSummary,
    name: str,
    versus: Mapping[str, Mapping[str, Comparison]],
    share: OracleShare | None,
) -> dict[str, object]:
    about = summary.methods[name]
    mine = summary.rows[summary.rows["method"] == name]
    found = {metric: averages(mine, name, metric) for metric in SUMMARISED}
    verdicts = acting(mine, name)
    return {
        "description": about.description,
        "training_regime": about.regime,
        "role": role_of(name, about.regime),
        "notes": list(about.notes),
        "outages": len(mine),
        "failed": int(mine[summary.metric].isna().sum()),
        "figures": {
            metric: {"mean": one.mean, "median": one.median, "p90": one.p90}
            for metric, one in found.items()
        },
        "versus": {
            baseline: asdict(found[name]) for baseline, found in versus.items() if name in found
        },
        "share_of_oracle": None if share is None else asdict(share),
        "safeguard": None if verdicts is None else _safeguard(mine, name, verdicts),
    }


def _safeguard(rows: pd.DataFrame, name: str, verdicts: Acting) -> dict[str, object]:
    found = reasons(rows, [name])[["used", "outages", "reason"]]
    return {**asdict(verdicts), "reasons": found.to_dict(orient="records")}


def _drive(drive: DriveSummary) -> dict[str, object]:
    return {
        "name": drive.name,
        "source": drive.source,
        "license": drive.license,
        "duration_s": drive.duration,
        "distance_m": drive.distance,
        "judged_by": drive.judged_by,
        "outages": len(drive.placement.outages),
        "excluded": [
            {"start_s": one.start, "end_s": one.end, "reason": one.reason}
            for one in drive.placement.excluded
        ],
        "notes": list(drive.placement.notes),
    }


def without_nan(value: object) -> object:
    """Return plain values with null for figures that are not known, as JSON has no NaN.

    Args:
        value: Numbers, words, lists and mappings of them.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(entry) for entry in value]
    return value
