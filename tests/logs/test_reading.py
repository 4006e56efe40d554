import pytest
import yaml

from navlearn.errors import ConfigError, LogError, LogNotFoundError
from navlearn.logs.formats.native import save_log
from navlearn.logs.reading import read_log, recognise_format


def touch(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"")
    return path


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["raw/town/rover/Mat/INSPVA.mat", "csv/imu.csv.gz"], "navinst"),
        (["raw/f_w_IMSseconds_dt.mat"], "navinst"),
        (["raw/a.MF4", "csv/imu.csv.gz"], "canedge"),
        (["raw/a.mf4"], "canedge"),
        (["log.json", "imu.csv.gz"], "native"),
        (["imu.csv"], "csv"),
        (["csv/imu.parquet"], "csv"),
    ],
)
def test_formats_are_recognised_by_their_files(tmp_path, names, found):
    for name in names:
        touch(tmp_path / "log" / name)
    assert recognise_format(tmp_path / "log") == found


def test_files_are_recognised(tmp_path):
    assert recognise_format(touch(tmp_path / "a.MF4")) == "canedge"
    assert recognise_format(touch(tmp_path / "log.json")) == "native"


def test_an_unknown_folder(tmp_path):
    touch(tmp_path / "log" / "notes.txt")
    with pytest.raises(LogError, match=r"no known log format; looked for INSPVA.mat .*notes\.txt"):
        read_log(tmp_path / "log")
    with pytest.raises(LogError, match=r"found the file notes\.txt"):
        read_log(tmp_path / "log" / "notes.txt")


def test_a_missing_path_lists_what_is_there(tmp_path):
    touch(tmp_path / "kingston_2008" / "x")
    message = r"kingstn/raw: does not exist; .* holds kingston_2008/"
    with pytest.raises(LogNotFoundError, match=message):
        read_log(tmp_path / "kingstn" / "raw")
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "kingstn")


def test_an_empty_folder(tmp_path):
    with pytest.raises(LogError, match="found nothing"):
        read_log(tmp_path)


def test_an_unknown_format(tmp_path):
    with pytest.raises(ConfigError, match=r"unknown format 'navnist' \(did you mean 'navinst'\?\)"):
        read_log(tmp_path, format="navnist")


def test_several_csv_drives(tmp_path):
    for name in ("one", "two"):
        touch(tmp_path / name / "imu.csv")
    with pytest.raises(LogError, match="2 drives below it"):
        read_log(tmp_path)


def test_a_native_log_by_folder_file_and_descriptor(tmp_path, make_log):
    folder = save_log(make_log(), tmp_path / "data" / "drive")
    descriptor = tmp_path / "drive.yaml"
    descriptor.write_text("name: x\nformat: native\npath: data/drive\n")
    for path in (folder, folder / "log.json", tmp_path / "data", descriptor):
        assert read_log(path).metadata.name == "small"


def test_a_descriptor_as_format(tmp_path, tables):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    for name, table in tables.items():
        table.rename(columns={"speed": "v"}).to_csv(folder / f"{name}.csv", index=False)
    layout = {name: {"file": f"{name}.csv"} for name in tables}
    layout["odometer"]["columns"] = {"speed": "v"}
    descriptor = tmp_path / "layout.yaml"
    entries = {"name": "layout", "format": "csv", "path": "nowhere", "tables": layout}
    descriptor.write_text(yaml.safe_dump(entries))
    assert len(read_log(folder, format=str(descriptor)).odometer) == 21
    with pytest.raises(LogNotFoundError, match=r"layout\.yaml: path nowhere .*NAVLEARN_DATA"):
        read_log(descriptor)
    with pytest.raises(ConfigError, match="its format is csv, but format=native was asked"):
        read_log(descriptor, format="native")
