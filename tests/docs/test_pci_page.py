"""The page on PCI: its code runs, and its options are those of the code."""

import dataclasses
import re
from pathlib import Path

import pandas as pd
import pytest
import torch

from navlearn.error_models.pci import PciOptions

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "pci.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"[+-]?\b\d+\.?\d*(?:e[+-]\d+)?\b")


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A table such as the page asks for, in the working folder."""
    noise = torch.randn(900, 3, generator=torch.Generator().manual_seed(1)).double()
    rate, speed = 0.1 * noise[:, 0], 12.0 + 3.0 * noise[:, 1]
    v = rate + 0.4 * rate.roll(1)
    error = 0.001 + 0.02 * v + 0.1 * v**2 + 3e-4 * noise[:, 2]
    columns = {"yaw_rate": rate, "speed": speed, "rate_error": error}
    monkeypatch.chdir(tmp_path)
    pd.DataFrame({name: value.numpy() for name, value in columns.items()}).to_csv("mine.csv")


@pytest.mark.usefixtures("mine")
def test_the_code_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    found: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, found)
    printed = capsys.readouterr().out
    shown = re.search(r"```text\n(.*?)```", PAGE, re.DOTALL)
    assert shown
    told = printed[printed.index("error[k]") :].splitlines()
    for line, other in zip(shown[1].splitlines(), told, strict=False):
        assert NUMBER.sub("#", line) == NUMBER.sub("#", other)
        numbers = [float(x) for x in NUMBER.findall(line)]
        assert numbers == pytest.approx(
            [float(x) for x in NUMBER.findall(other)], rel=1e-2, abs=1e-6
        )
    assert Path("predictor.pt").is_file()
    models = found["models"]
    assert isinstance(models, list)
    assert len(models) == 2


def test_the_page_shows_every_option_with_its_default() -> None:
    shown = dict(re.findall(r"^\| `(\w+)` \| (\S+) \|", PAGE, re.MULTILINE))
    defaults = {field.name: field.default for field in dataclasses.fields(PciOptions)}
    assert shown.keys() == defaults.keys()
    for name, value in defaults.items():
        assert shown[name] == (f"{value:g}" if isinstance(value, float) else str(value)), name
