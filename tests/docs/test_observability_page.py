"""The page on observability: its code runs, and its tables are those that its examples print."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "observability.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"−?\d+\.\d+")


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assert_stands_in_page(printed: str) -> None:
    """Words and ranks to the letter, other figures to a little more than their last digit."""
    lines = printed.splitlines()
    begin = PAGE.index(lines[0])
    shown = PAGE[begin:].splitlines()[: len(lines)]
    for line, other in zip(lines, shown, strict=True):
        assert NUMBER.sub("#", line) == NUMBER.sub("#", other)
        for a, b in zip(NUMBER.findall(line), NUMBER.findall(other), strict=True):
            found, expected = (float(x.replace("−", "-")) for x in (a, b))
            assert found == pytest.approx(expected, rel=0.02, abs=0.011)


def test_what_motions_tell_stands_in_the_page() -> None:
    module = example("observability_by_motion")
    assert_stands_in_page(module.imu_table())
    assert_stands_in_page(module.riss_table())


def test_the_drive_stands_in_the_page() -> None:
    module = example("observability_of_a_drive")
    assert_stands_in_page(module.phase_table(module.recorded()))


def test_the_code_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    found: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, found)
    printed = capsys.readouterr().out.splitlines()
    shown = re.findall(r"```text\n(.*?)\n```", PAGE, re.DOTALL)
    number = re.compile(r"\d+\.\d+")
    for line, other in zip(printed, shown, strict=True):
        assert number.sub("#", line) == number.sub("#", other)
        assert [float(x) for x in number.findall(line)] == pytest.approx(
            [float(x) for x in number.findall(other)], rel=1e-3, abs=0.006
        )
