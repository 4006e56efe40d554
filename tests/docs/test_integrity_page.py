"""The page on integrity shows every verdict, and its code runs."""

import re
from pathlib import Path
from typing import Any

from navlearn.fusion.measurements import Verdict

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "integrity.md").read_text(encoding="utf-8")


def test_every_verdict_is_explained() -> None:
    shown = re.findall(r"^\| `([A-Z_]+)` \|", PAGE, flags=re.MULTILINE)
    assert shown == [verdict.name for verdict in Verdict]


def test_the_code_of_the_page_runs() -> None:
    found: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
        exec(code, found)
    assert found["options"].gate is found["gate"]
    assert float(found["track"].refused) == 0.0
