"""Warnings on the command line: each once, in words."""

import pytest

from navlearn.cli.app import show_once


def test_a_warning_is_shown_once_without_code(capsys: pytest.CaptureFixture[str]) -> None:
    show = show_once()
    for text in ("raise speed_noise", "raise speed_noise", "no figures were drawn"):
        show(UserWarning(text), UserWarning, "file.py", 7)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == [
        "navlearn: warning: raise speed_noise",
        "navlearn: warning: no figures were drawn",
    ]
