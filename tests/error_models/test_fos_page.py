import re
from dataclasses import fields
from pathlib import Path

from navlearn.error_models.fos_options import FosOptions

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "fos.md").read_text(encoding="utf-8")


def test_page_shows_every_option_with_its_default():
    rows = [line.split("|") for line in PAGE.splitlines() if line.startswith("| `")]
    shown = {row[1].strip().strip("`"): row[2].strip().strip("`") for row in rows}
    assert shown == {field.name: str(field.default) for field in fields(FosOptions)}


def test_code_of_the_page_runs_and_prints_what_it_says(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    printed = capsys.readouterr().out.strip()
    assert len(blocks) == 2
    assert f"`{printed}`" in PAGE
    assert len(names["model"].terms) >= 2
