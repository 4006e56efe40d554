"""Documents that state what the code states: they must not drift apart."""

import dataclasses
import re
from pathlib import Path

import pytest
import yaml

import navlearn
from navlearn.export import PredictorMetadata
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.gate_options import GateOptions
from navlearn.logs.columns import REQUIRED, TABLES
from navlearn.outages.metrics import FIGURES
from navlearn.outages.schedule import DYNAMICS, PLACEMENTS, VISIBLE
from navlearn.outages.statistics import FEWEST_UNITS, HARM
from navlearn.outages.tables import HEAD
from navlearn.outages.track import TURN_STEP
from navlearn.recipe import Recipe
from navlearn.recipe.sections import OutageSection, TrainingSection
from navlearn.recipe.strict import Section

ROOT = Path(__file__).resolve().parents[2]


def tables_of(document: str) -> dict[str, list[list[str]]]:
    """Return the rows of each Markdown table, without its head, by the last heading before it."""
    found: dict[str, list[list[str]]] = {}
    heading = ""
    for line in (ROOT / document).read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ").strip("`")
        elif line.startswith("|"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            found.setdefault(heading, []).append(cells)
    return {name: rows[2:] for name, rows in found.items()}


@pytest.mark.parametrize("name", list(TABLES))
def test_conventions_show_the_columns_of_the_code(name: str) -> None:
    expected = [
        [f"`{column}`{'*' if column in REQUIRED[name] else ''}", meaning]
        for column, meaning in TABLES[name].items()
    ]
    assert tables_of("docs/conventions.md")[name] == expected


def as_written(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


@pytest.mark.parametrize(
    ("heading", "section"), [("outages", OutageSection), ("training", TrainingSection)]
)
def test_recipe_page_shows_keys_and_defaults(heading: str, section: type[Section]) -> None:
    shown = {row[0].strip("`"): row[1].strip("`") for row in tables_of("docs/recipes.md")[heading]}
    assert list(shown) == list(section.model_fields)
    defaults = section().model_dump()
    defaults.pop("classes", None)
    for key, value in defaults.items():
        assert shown[key] == as_written(value), key


@pytest.mark.parametrize("options", [UnscentedOptions, GateOptions])
def test_recipe_page_shows_options_of_ingredients(options: type) -> None:
    rows = tables_of("docs/recipes.md")["`unscented`, `tuned`, `integrity`".strip("`")]
    fields = dataclasses.fields(options)
    first = [row[0].strip("`") for row in rows].index(fields[0].name)
    shown = rows[first : first + len(fields)]
    assert [row[0].strip("`") for row in shown] == [field.name for field in fields]
    for row, field in zip(shown, fields, strict=True):
        assert row[1] == as_written(field.default), field.name


def test_recipe_page_shows_every_key_of_a_recipe() -> None:
    shown = [row[0].strip("`") for row in tables_of("docs/recipes.md")["Recipe"]]
    assert shown == list(Recipe.model_fields)


def test_predictor_page_shows_every_entry_of_the_metadata() -> None:
    shown = [row[0] for row in tables_of("docs/predictors.md")["Metadata"]]
    names = [name for cell in shown for name in re.findall(r"`(\w+)`", cell)]
    assert names == [field.name for field in dataclasses.fields(PredictorMetadata)]


def test_outage_page_shows_every_column_in_order() -> None:
    shown = [row[0].strip("`") for row in tables_of("docs/outages.md")["Figures"]]
    figures = [name for name in FIGURES if name not in HEAD]
    verdict = ("satellites", "satellites_visible", "azimuth_judged_by", "used", "reason")
    assert shown == [*HEAD, *verdict, *figures, "failure"]


def test_outage_page_shows_every_placement() -> None:
    shown = {row[0].strip("`") for row in tables_of("docs/outages.md")["Placement"]}
    assert shown == set(PLACEMENTS)
    rules = {row[0].strip("`") for row in tables_of("docs/outages.md")["Partial outages"]}
    assert rules == set(VISIBLE)
    text = (ROOT / "docs" / "outages.md").read_text(encoding="utf-8")
    assert {word for word in DYNAMICS if f"`{word}`" not in text} == set()
    assert f"steps of {TURN_STEP:g} s" in text
    assert FEWEST_UNITS == 6  # "at least six drives"
    assert round(100.0 * (HARM - 1.0)) == 10  # "over 10 % worse"


def test_every_cited_source_is_in_the_bibliography() -> None:
    bibliography = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    keys = re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE)
    assert len(keys) == len(set(keys))
    cited = {
        (key, path.name)
        for path in (ROOT / "navlearn").rglob("*.py")
        for key in re.findall(r"\[([A-Z][A-Za-z]+[12]\d{3})\b", path.read_text(encoding="utf-8"))
    }
    assert len(cited) > 5
    assert {item for item in cited if item[0] not in keys} == set()


def test_version_is_one_and_the_same() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == navlearn.__version__
    assert citation["license"] == "Apache-2.0"


def test_relative_links_lead_somewhere() -> None:
    documents = [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "models").glob("*.md"),
    ]
    broken = []
    for document in documents:
        text = document.read_text(encoding="utf-8")
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#]+)", text):
            if not (document.parent / target).exists():
                broken.append(f"{document.name}: {target}")
    assert broken == []


def test_pre_commit_hooks_are_local() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    assert [repo["repo"] for repo in hooks["repos"]] == ["local"]
    names = {hook["id"] for repo in hooks["repos"] for hook in repo["hooks"]}
    assert names == {"ruff", "ruff-format", "mypy", "lint-imports"}
