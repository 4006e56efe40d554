"""What a check found: findings, measured figures, and the report that holds both."""

import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

Severity = Literal["error", "warning", "info"]

_ORDER = {"error": 0, "warning": 1, "info": 2}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that a reader of the log should know.

    Attributes:
        severity: "error" would ruin a result, "warning" may bend one, "info" is good to know.
        topic: Short name of the check, such as "yaw rate sign".
        where: Table, with time or row where that narrows it.
        found: What was found, with figures.
        expected: What a sound log shows.
        remedy: What to do.
    """

    severity: Severity
    topic: str
    where: str
    found: str
    expected: str
    remedy: str

    def to_text(self, width: int = 100) -> str:
        """Return the finding: a headline, then what was found, what was expected, what to do.

        Args:
            width: Longest line, characters.
        """
        parts = (self.found, f"expected: {self.expected}", f"to do: {self.remedy}")
        indent = " " * 8
        body = (
            textwrap.fill(
                part,
                width,
                initial_indent=indent,
                subsequent_indent=indent,
                break_long_words=False,
                break_on_hyphens=False,
            )
            for part in parts
        )
        return "\n".join((f"{self.severity.upper():7} {self.topic} [{self.where}]", *body))


@dataclass(kw_only=True)
class Part:
    """What one check contributes to a report; filled as the check runs."""

    findings: list[Finding] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    not_observable: dict[str, str] = field(default_factory=dict)
    gaps: list[tuple[str, float, float]] = field(default_factory=list)

    def add(
        self, severity: Severity, topic: str, where: str, found: str, expected: str, remedy: str
    ) -> None:
        """Note a finding."""
        self.findings.append(
            Finding(
                severity=severity,
                topic=topic,
                where=where,
                found=found,
                expected=expected,
                remedy=remedy,
            )
        )

    def note(self, name: str, value: float, std: float, suffix: str = "") -> None:
        """Note a figure with its standard deviation; the suffix is its unit."""
        self.figures[name + suffix] = value
        self.figures[f"{name}_std{suffix}"] = std


@dataclass(frozen=True, kw_only=True)
class QualityReport:
    """The verdict on a log.

    Attributes:
        name: Name of the log.
        findings: Errors first, then warnings, then the rest.
        figures: Measured numbers by name; the unit stands at the end of the name (``_s``,
            ``_hz``, ``_m``, ``_deg_per_h``), without which a figure is a ratio or a count.
            Latencies are positive where a stream is stamped late, and are those left where the
            log's metadata say that some were removed; scales are reported per true;
            ``gyro_bias`` includes the vertical Earth rate, which stands beside it.
        not_observable: Figures that this log cannot tell, by name, with the reason.
        gaps: Interruptions, columns ``table``, ``start_s``, ``length_s``.
    """

    name: str
    findings: tuple[Finding, ...]
    figures: Mapping[str, float]
    not_observable: Mapping[str, str]
    gaps: pd.DataFrame

    @property
    def ok(self) -> bool:
        """Whether nothing was found that would ruin a result."""
        return not self.of("error")

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """Return the findings of one severity."""
        return tuple(finding for finding in self.findings if finding.severity == severity)

    def to_text(self, width: int = 100) -> str:
        """Return the report as plain text: verdict, findings, figures, gaps.

        Args:
            width: Longest line, characters.
        """
        counts = ", ".join(
            f"{len(self.of(severity))} {severity}" for severity in ("error", "warning", "info")
        )
        lines = [f"{self.name}: {'usable' if self.ok else 'NOT usable'} ({counts})", ""]
        lines += [finding.to_text(width) for finding in self.findings]
        lines += ["", *_figure_lines(self.figures, self.not_observable)]
        if len(self.gaps):
            lines += ["", "gaps", *(f"  {line}" for line in _gap_lines(self.gaps))]
        return "\n".join(lines) + "\n"


def assemble(name: str, parts: Iterable[Part]) -> QualityReport:
    """Return the report made of the parts that the checks returned."""
    findings: list[Finding] = []
    figures: dict[str, float] = {}
    missing: dict[str, str] = {}
    gaps: list[tuple[str, float, float]] = []
    for part in parts:
        findings += part.findings
        figures |= part.figures
        missing |= part.not_observable
        gaps += part.gaps
    return QualityReport(
        name=name,
        findings=tuple(sorted(findings, key=lambda finding: _ORDER[finding.severity])),
        figures=figures,
        not_observable={key: why for key, why in missing.items() if key not in figures},
        gaps=pd.DataFrame(gaps, columns=["table", "start_s", "length_s"]),
    )


_RHYTHM = ("rate_hz", "jitter_s", "longest_gap_s", "missing", "interruptions")
"""Figures that every table has; they are printed side by side."""


_LEGEND = (
    "figure (latency: positive where stamped late; scale: reported per true;",
    "        gyro_bias: reading without a turn of the car, Earth rate included)",
)


def _figure_lines(figures: Mapping[str, float], missing: Mapping[str, str]) -> list[str]:
    tables = [key.removesuffix("_rate_hz") for key in figures if key.endswith("_rate_hz")]
    rhythm = {f"{table}_{name}" for table in tables for name in _RHYTHM}
    lines = ["table      " + " ".join(f"{name:>14}" for name in _RHYTHM)] if tables else []
    for table in tables:
        values = (figures[f"{table}_{name}"] for name in _RHYTHM)
        lines.append(f"{table:10} " + " ".join(f"{_tidy(value):14.6g}" for value in values))
    shown = {key: value for key, value in figures.items() if key not in rhythm}
    spreads = {_spread_of(key): value for key, value in shown.items() if "_std" in key}
    width = max((len(key) for key in [*shown, *missing]), default=0)
    lines += ["", *_LEGEND] if shown or missing else []
    for key, value in shown.items():
        if "_std" not in key or _spread_of(key) not in shown:
            spread = f" ± {spreads[key]:.2g}" if key in spreads else ""
            lines.append(f"  {key:{width}}  {value:.5g}{spread}")
    lines += [f"  {key:{width}}  not observable: {why}" for key, why in missing.items()]
    return lines


def _tidy(value: float) -> float:
    """Return a figure without the rounding of time stamps."""
    return 0.0 if abs(value) < 1e-9 else value


def _spread_of(key: str) -> str:
    """Return the figure whose standard deviation a key names."""
    return "".join(key.rsplit("_std", 1))


def _gap_lines(gaps: pd.DataFrame, most: int = 12) -> list[str]:
    longest = gaps.nlargest(most, "length_s").sort_values("start_s")
    lines = [
        f"{row.table:10} {row.start_s:10.2f} s  for {row.length_s:8.2f} s"
        for row in longest.itertuples()
    ]
    hidden = len(gaps) - len(longest)
    return [*lines, f"and {hidden} shorter ones"] if hidden else lines
