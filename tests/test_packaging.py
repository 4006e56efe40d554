"""What is installed is the package alone, whole, with the extras that its messages name."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

import navlearn

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
INSTALLED = Path(navlearn.__file__).resolve().parent


def test_version_is_one() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    version = importlib.metadata.version("navlearn")
    assert version == navlearn.__version__ == PROJECT["project"]["version"]
    assert f"version: {version}\n" in citation


def test_extras_named_in_messages_exist() -> None:
    offered = set(importlib.metadata.metadata("navlearn").get_all("Provides-Extra") or [])
    named = {
        extra
        for path in (ROOT / "navlearn").rglob("*.py")
        for extra in re.findall(r"navlearn\[(\w+)\]", path.read_text(encoding="utf-8"))
    }
    assert {"report", "canedge", "parquet"} <= named <= offered
    assert {"test", "dev"} <= offered


def test_everything_imported_is_required() -> None:
    imported = {
        name
        for path in (ROOT / "navlearn").rglob("*.py")
        for name in re.findall(
            r"^\s*(?:import|from) ([a-z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE
        )
    }
    extras = PROJECT["project"]["optional-dependencies"]
    required = PROJECT["project"]["dependencies"] + [
        requirement for name in ("report", "canedge", "parquet") for requirement in extras[name]
    ]
    modules = {re.match(r"[\w-]+", requirement)[0] for requirement in required}
    modules = {"yaml" if name == "pyyaml" else name for name in modules}
    # Pandas is what reads Parquet, with pyarrow behind it.
    assert modules - imported == {"pyarrow"}


def test_wheel_holds_the_package_alone() -> None:
    if INSTALLED == ROOT / "navlearn":
        pytest.skip("imported from the checkout: there is no wheel to look at")
    files = importlib.metadata.files("navlearn")
    assert files is not None
    inside = [Path(str(file)) for file in files]
    shipped = {path for path in inside if path.parts[0] == "navlearn" and path.suffix != ".pyc"}
    others = {path.parts[0] for path in inside} - {"navlearn"}
    assert all(re.fullmatch(r"\.\.|navlearn-[\d.]+\.dist-info", name) for name in others)
    expected = {
        path.relative_to(ROOT)
        for path in (ROOT / "navlearn").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert shipped == expected
    assert Path("navlearn/py.typed") in shipped
