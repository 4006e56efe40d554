import json
from pathlib import Path

import pytest

from navlearn.errors import OutputExistsError
from navlearn.outages.output import MARKER, prepare_output_folder


def finished_run(path: Path) -> Path:
    output = prepare_output_folder(path)
    output.claim("report.md").write_text("old")
    output.claim("models/a.pt").write_text("old")
    output.claim("store/").joinpath("x.npz").write_text("old")
    output.finish()
    return path


def test_a_new_folder_is_made_and_files_are_listed_before_they_are_written(tmp_path: Path) -> None:
    output = prepare_output_folder(tmp_path / "deep" / "run")
    path = output.claim("models/net.pt")
    assert path.parent.is_dir()
    assert not path.exists()
    marker = json.loads((output.path / MARKER).read_text())
    assert marker == {"files": ["models/net.pt"], "finished": False}


def test_a_finished_run_is_not_overwritten(tmp_path: Path) -> None:
    run = finished_run(tmp_path / "run")
    with pytest.raises(OutputExistsError, match=r"finished run.*--force"):
        prepare_output_folder(run)
    assert (run / "report.md").read_text() == "old"


def test_an_interrupted_run_may_go_on(tmp_path: Path) -> None:
    first = prepare_output_folder(tmp_path)
    first.claim("store/").joinpath("x.npz").write_text("kept")
    again = prepare_output_folder(tmp_path)
    assert (again.claim("store/") / "x.npz").read_text() == "kept"


def test_force_removes_what_the_run_wrote_and_nothing_else(tmp_path: Path) -> None:
    run = finished_run(tmp_path / "run")
    (run / "my notes.txt").write_text("mine")
    (run / "models" / "mine.pt").write_text("mine")
    prepare_output_folder(run, force=True)
    left = sorted(p.relative_to(run).as_posix() for p in run.rglob("*") if p.is_file())
    assert left == [MARKER, "models/mine.pt", "my notes.txt"]


def test_force_never_touches_a_foreign_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    for force in (False, True):
        with pytest.raises(OutputExistsError, match="no navlearn run wrote"):
            prepare_output_folder(tmp_path, force=force)
    assert (tmp_path / "thesis.tex").read_text() == "mine"
    assert not (tmp_path / MARKER).exists()


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("x")
    with pytest.raises(OutputExistsError, match="is a file"):
        prepare_output_folder(tmp_path / "run", force=True)


def test_a_foreign_file_in_the_way_is_not_claimed(tmp_path: Path) -> None:
    output = prepare_output_folder(tmp_path)
    (tmp_path / "report.md").write_text("mine")
    with pytest.raises(OutputExistsError, match="no navlearn run wrote it"):
        output.claim("report.md")


@pytest.mark.parametrize("name", ["../out.txt", "/etc/x", "a/../../b"])
def test_no_file_outside_is_claimed(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputExistsError, match="leads out"):
        prepare_output_folder(tmp_path).claim(name)


def test_a_marker_that_names_files_outside_removes_nothing(tmp_path: Path) -> None:
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    (run / MARKER).write_text(json.dumps({"files": ["../victim.txt"], "finished": True}))
    with pytest.raises(OutputExistsError, match="not in the folder"):
        prepare_output_folder(run, force=True)
    assert victim.exists()


def test_a_broken_marker_is_refused(tmp_path: Path) -> None:
    (tmp_path / MARKER).write_text("{")
    with pytest.raises(OutputExistsError, match="cannot be read as the marker"):
        prepare_output_folder(tmp_path, force=True)
