"""The lower floors need torch alone."""

import subprocess
import sys

import pytest

HEAVY = ("pandas", "lightning", "matplotlib", "scipy", "yaml", "pydantic")


@pytest.mark.parametrize(
    "module", ["navlearn.earth", "navlearn.attitude", "navlearn.frames", "navlearn.mechanization"]
)
def test_lower_floors_load_nothing_heavy(module):
    code = f"import sys, {module}; print([m for m in {HEAVY!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
