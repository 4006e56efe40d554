"""Every benchmark runs, on the smallest work that it takes."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"
SMALLEST = {
    "anarx": ["--samples", "300", "--iterations", "3"],
    "ekf": ["--minutes", "1", "--window", "10", "--repeat", "1"],
    "fos": ["--rows", "100", "--repeats", "1", "--draws", "2"],
    "fos_peers": ["--rows", "100", "--repeats", "1", "--noise", "0.3", "--seeds", "1"],
    "integrity_detection": [
        *("--seeds", "11", "--seconds", "400", "--kinds", "spike", "none"),
        *("--ways", "χ² gate", "Huber"),
    ],
    "ins_alignment": [
        *("--grades", "mems_m", "--seeds", "11", "--kitti", "--windows", "15"),
        *("--duration", "60"),
    ],
    "ins_standstill": ["--logs", "kitti_0034"],
    "ins_ekf": [
        *("--minutes", "1", "--window", "5", "--count", "2", "--short", "2", "--states", "15"),
        *("--repeats", "1"),
    ],
    "mechanization": ["--repeats", "1", "--loop-samples", "100"],
    "pci": ["--repeats", "1", "--windows", "2", "--draws", "2", "--rows", "100", "--seeds", "1"],
    "tuning": [
        *("--parts", "known", "time", "simulated", "--seconds", "400", "--hour", "300"),
        *("--steps", "2", "--factors", "1", "--grades", "mems_m", "--tune-seeds", "11"),
        *("--judge-seeds", "13", "--outages", "1", "--warm-up", "200"),
    ],
    "tuning_by_differences": ["--grades", "mems_m", "--duration", "400"],
    "tuning_spacing": [
        *("--grades", "mems_m", "--spacings", "5", "--seconds", "400", "--steps", "2"),
        *("--tune-seeds", "11", "--judge-seeds", "13", "--outages", "1", "--warm-up", "200"),
    ],
    "ukf": ["--minutes", "1", "--window", "10", "--repeat", "1"],
    "predictor": ["--rows", "20", "--repeats", "1"],
    "preintegration": [
        *("--windows", "4", "--samples", "10", "--repeats", "1", "--seconds", "60"),
    ],
    "pyins_filter": [
        *("--seconds", "150", "--grades", "tactical", "--seeds", "11"),
        *("--runs", "1", "--methods", "exact"),
    ],
    "pyins_strapdown": ["--seconds", "60", "--seeds", "11", "--minutes", "1", "--repeats", "1"],
    "smoothing": [
        *("--grades", "mems_m", "--seeds", "11", "--outages", "1x30"),
        *("--steps", "50", "--repeats", "1"),
    ],
    "tight_ekf": [
        *("--minutes", "1", "--window", "5", "--count", "2", "--short", "2", "--repeats", "1"),
    ],
    "ukf_against_ekf": [
        *("--seeds", "1", "--windows", "1", "--seconds", "60", "--cases", "as usual"),
    ],
    "unscented_spread": [
        *("--seeds", "11", "--draws", "1", "--degrees", "20", "--filters", "extended", "α 1"),
    ],
    "ukf_vehicles": ["--minutes", "1", "--short", "2", "--repeats", "1"],
    "strapdown": [
        *("--repeats", "1", "--samples", "4000", "--loop-samples", "30"),
        *("--drift-minutes", "0.2", "--compare-minutes", "0.2"),
    ],
    "satellite_positions": ["--points", "2", "--batch", "50", "--repeats", "1"],
    "simulated_skies": ["--seeds", "11", "--seconds", "240"],
    "simulator": ["--hours", "0.05"],
    "single_point": ["--logs", "simulated", "--repeat", "1", "--seconds", "60"],
}


def test_every_benchmark_is_listed() -> None:
    assert {path.stem for path in FOLDER.glob("*.py")} == set(SMALLEST)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SMALLEST))
def test_benchmark_runs(name: str) -> None:
    command = [sys.executable, str(FOLDER / f"{name}.py"), *SMALLEST[name]]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.strip()
