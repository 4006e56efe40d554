import builtins
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from navlearn.errors import LogError, LogNotFoundError, MissingExtraError
from navlearn.logs.reading import read_log

asammdf = pytest.importorskip("asammdf", reason="navlearn[canedge] is not installed")

# Messages of a CANmod.gps: signal, first bit, bits, factor, offset.
MESSAGES = {
    (1, "gnss_status"): [("FixType", 0, 3, 1, 0), ("Satellites", 3, 5, 1, 0)],
    (2, "gnss_time"): [("TimeValid", 0, 1, 1, 0), ("Epoch", 8, 40, 0.001, 1577840400)],
    (3, "gnss_pos"): [
        ("PositionValid", 0, 1, 1, 0),
        ("Latitude", 1, 28, 1e-6, -90),
        ("Longitude", 29, 29, 1e-6, -180),
        ("PositionAccuracy", 58, 6, 1, 0),
    ],
    (4, "gnss_altitude"): [
        ("AltitudeValid", 0, 1, 1, 0),
        ("Altitude", 1, 18, 0.1, -6000),
        ("AltitudeAccuracy", 19, 13, 1, 0),
    ],
    (5, "gnss_attitude"): [("AttitudeValid", 0, 1, 1, 0), ("Heading", 43, 12, 0.1, 0)],
    (7, "gnss_speed"): [
        ("SpeedValid", 0, 1, 1, 0),
        ("Speed", 1, 20, 0.001, 0),
        ("SpeedAccuracy", 21, 19, 0.001, 0),
    ],
    (9, "gnss_imu"): [
        ("ImuValid", 0, 1, 1, 0),
        ("AccelerationX", 1, 10, 0.125, -64),
        ("AccelerationY", 11, 10, 0.125, -64),
        ("AccelerationZ", 21, 10, 0.125, -64),
        ("AngularRateX", 31, 11, 0.25, -256),
        ("AngularRateY", 42, 11, 0.25, -256),
        ("AngularRateZ", 53, 11, 0.25, -256),
    ],
}
EPOCH = 1627274466.0


def dictionary():
    """Return the messages as the text of a .dbc file, with a text for every valid flag."""
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_:", ""]
    for (number, name), signals in MESSAGES.items():
        lines.append(f"BO_ {number} {name}: 8 Vector__XXX")
        for signal, first, bits, factor, offset in signals:
            lines.append(
                f' SG_ {signal} : {first}|{bits}@1+ ({factor},{offset}) [0|0] "" Vector__XXX'
            )
        lines.append("")
    for (number, _), signals in MESSAGES.items():
        for signal, *_ in signals:
            if signal.endswith("Valid"):
                lines.append(f'VAL_ {number} {signal} 0 "Invalid" 1 "Valid" ;')
    return "\n".join(lines) + "\n"


def frame(t, number, **values):
    """Return one CAN frame, packed by hand."""
    packed = 0
    for signal, first, _, factor, offset in next(
        s for (n, _), s in MESSAGES.items() if n == number
    ):
        raw = round((values.get(signal, 1 if signal.endswith("Valid") else 0) - offset) / factor)
        packed |= max(raw, 0) << first
    return t, number, packed.to_bytes(8, "little")


def burst(t, epoch, *, speed=10.0, valid=1, lat=56.1):
    """Return the messages of one fix as they follow each other on the bus."""
    return [
        frame(t, 1, FixType=3, Satellites=12),
        frame(t + 0.0005, 2, Epoch=epoch),
        frame(t + 0.001, 3, PositionValid=valid, Latitude=lat, Longitude=10.0, PositionAccuracy=2),
        frame(t + 0.0015, 4, Altitude=55.5, AltitudeAccuracy=3),
        frame(t + 0.002, 5, Heading=90.0),
        frame(t + 0.0025, 7, Speed=speed, SpeedAccuracy=0.25),
    ]


def obd(t, speed_kmh, identifier=0x7E8, pid=0x0D):
    return t, identifier, bytes([3, 0x41, pid, speed_kmh, 0, 0, 0, 0])


def imu(t, *, valid=1):
    return frame(
        t,
        9,
        ImuValid=valid,
        AccelerationX=9.75,
        AccelerationY=-1.0,
        AccelerationZ=0.5,
        AngularRateX=20.0,
        AngularRateY=-3.0,
        AngularRateZ=1.0,
    )


def write(path, frames, start=0.0):
    from asammdf import MDF, Signal
    from asammdf.blocks import v4_constants as v4c
    from asammdf.blocks.source_utils import Source

    frames = sorted((t - start, number, data) for t, number, data in frames)
    fields = {
        "BusChannel": np.ones(len(frames), "u1"),
        "ID": np.array([f[1] for f in frames], "<u4"),
        "IDE": np.zeros(len(frames), "u1"),
        "DLC": np.full(len(frames), 8, "u1"),
        "DataLength": np.full(len(frames), 8, "u1"),
        "DataBytes": np.array([list(f[2]) for f in frames], "u1"),
        "Dir": np.zeros(len(frames), "u1"),
        "EDL": np.zeros(len(frames), "u1"),
        "BRS": np.zeros(len(frames), "u1"),
    }
    dtype = [(f"CAN_DataFrame.{n}", v.dtype, v.shape[1:]) for n, v in fields.items()]
    record = np.rec.fromarrays(list(fields.values()), dtype=dtype)
    source = Source("CAN", "CAN", "", v4c.SOURCE_BUS, v4c.BUS_TYPE_CAN)
    signal = Signal(record, np.array([f[0] for f in frames]), name="CAN_DataFrame", source=source)
    with MDF(version="4.11") as mdf:
        mdf.append([signal], acq_name="CAN", acq_source=source, common_timebase=True)
        mdf.groups[-1].channel_group.flags |= v4c.FLAG_CG_BUS_EVENT | v4c.FLAG_CG_PLAIN_BUS_EVENT
        mdf.start_time = datetime(2021, 7, 26, 4, 40, 54, tzinfo=UTC) + timedelta(seconds=start)
        mdf.save(path, overwrite=True)


def drive(folder, *, jitter=None, files=1, own_start=False):
    """Write 20 s of a drive, cut into files."""
    folder.mkdir(exist_ok=True)
    late = np.zeros(20) if jitter is None else jitter
    frames = [imu(0.01 * k) for k in range(1, 2000)]
    frames += [obd(0.2 + 0.5 * k, 36 + k) for k in range(39)]
    for k in range(20):
        frames += burst(0.4 + k + late[k], EPOCH + k)
    for part in range(files):
        first, last = 20.0 * part / files, 20.0 * (part + 1) / files
        inside = [f for f in frames if first <= f[0] < last]
        write(folder / f"{part + 1:08d}.mf4", inside, start=first if own_start else 0.0)
    (folder / "canmod.dbc").write_text(dictionary())
    return folder


def test_axes_units_and_flags(tmp_path):
    log = read_log(drive(tmp_path / "css"))
    first = log.imu.iloc[0]
    assert first[["accel_x", "accel_y", "accel_z"]].tolist() == [0.5, 1.0, 9.75]
    rates = np.degrees(first[["gyro_x", "gyro_y", "gyro_z"]].to_numpy())
    np.testing.assert_allclose(rates, [1.0, 3.0, 20.0])
    np.testing.assert_allclose(log.odometer["speed"] * 3.6, 36 + np.arange(39))
    fix = log.fixes.iloc[3]
    assert np.degrees(fix["lat"]) == pytest.approx(56.1, abs=1e-6)
    assert (fix["std_e"], fix["std_n"], fix["std_u"], fix["std_v"]) == (2.0, 2.0, 3.0, 0.25)
    assert (fix["v_e"], fix["v_n"]) == pytest.approx((10.0, 0.0), abs=1e-9)
    assert (fix["height"], fix["satellites"]) == pytest.approx((55.5, 12.0))
    assert log.metadata.time_origin == pytest.approx(0.01)


def test_several_files_are_one_drive(tmp_path):
    one, three = read_log(drive(tmp_path / "one")), read_log(drive(tmp_path / "three", files=3))
    each = read_log(drive(tmp_path / "each", files=3, own_start=True))
    for name, table in one.tables().items():
        np.testing.assert_allclose(three.tables()[name], table, atol=1e-9)
        np.testing.assert_allclose(each.tables()[name], table, atol=1e-6)


def test_jitter_of_arrival_is_removed(tmp_path):
    jitter = np.abs(np.random.default_rng(3).standard_normal(20)) * 0.03
    jitter[7] = 0.2
    log = read_log(drive(tmp_path / "css", jitter=jitter))
    steps = np.diff(log.fixes["t"])
    assert np.ptp(steps) < 1e-6
    assert steps.mean() == pytest.approx(1.0, abs=2e-3)


def test_invalid_samples_are_left_out(tmp_path):
    frames = [imu(0.01 * k, valid=k != 50) for k in range(1, 1000)]
    frames += [obd(0.5 * k, 10) for k in range(20)]
    # Answers to other requests and of other senders are no speed.
    frames += [obd(3.1, 99, pid=0x0C), obd(3.2, 99, identifier=0x7DF)]
    for k in range(8):
        frames += burst(0.4 + k, EPOCH + k, valid=k not in (2, 3))
    write(tmp_path / "a.mf4", frames)
    (tmp_path / "a.dbc").write_text(dictionary())
    log = read_log(tmp_path / "a.mf4")
    assert len(log.imu) == 998
    assert log.odometer["speed"].nunique() == 1
    assert log.fixes["lat"].isna().sum() == 2
    assert log.fixes["v_e"].notna().all()


def test_missing_dictionary_or_files(tmp_path):
    folder = drive(tmp_path / "css")
    (folder / "canmod.dbc").unlink()
    with pytest.raises(LogNotFoundError, match=r"0 \.dbc files beside 00000001\.mf4; exactly one"):
        read_log(folder)
    (folder / "00000001.mf4").unlink()
    with pytest.raises(LogNotFoundError, match=r"no \.MF4 file in or below it; found css/"):
        read_log(tmp_path, format="canedge")


@pytest.mark.parametrize("keep", [10, 500, 20000])
def test_a_truncated_file(tmp_path, keep):
    folder = drive(tmp_path / "css")
    whole = (folder / "00000001.mf4").read_bytes()
    (folder / "00000001.mf4").write_bytes(whole[:keep])
    with pytest.raises(LogError, match=r"^(00000001\.mf4|.*no valid|.*no OBD)"):
        read_log(folder)


@pytest.mark.parametrize(
    ("left_out", "what"), [(0x7E8, "OBD-II answer to PID 0x0D"), (3, "valid GNSS position")]
)
def test_a_drive_without_a_needed_message(tmp_path, left_out, what):
    frames = [imu(0.01 * k) for k in range(1, 1000)] + [obd(0.5 * k, 10) for k in range(20)]
    for k in range(8):
        frames += burst(0.4 + k, EPOCH + k, valid=0 if left_out == 3 else 1)
    frames = [f for f in frames if f[1] not in (left_out, 7 if left_out == 3 else -1)]
    write(tmp_path / "a.mf4", frames)
    (tmp_path / "a.dbc").write_text(dictionary())
    with pytest.raises(LogError, match=what):
        read_log(tmp_path)


def test_without_asammdf(tmp_path, monkeypatch):
    folder = drive(tmp_path / "css")
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "asammdf":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingExtraError, match=r"pip install navlearn\[canedge\]"):
        read_log(folder)
