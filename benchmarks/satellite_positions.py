"""Broadcast orbits and clocks beside RTKLIB on one navigation file, and how fast they go.

Every message of the file is read and propagated by both, across the time for which it is valid:
largest and RMS distance of positions, difference of velocities (RTKLIB's by a central difference
of two seconds) and of clocks before the group delay. GLONASS also with RTKLIB's shorter constants
and steps of a minute. Then satellites per second of this package, one thread, the least of the
repeats, and of RTKLIB through its Python binding, which takes them one by one. Command:

    python benchmarks/satellite_positions.py [--file FILE.nav] [--batch 100000]

Without a file that of datasets/rinex_static is taken. RTKLIB is installed by: pip install pyrtklib
"""

import argparse
import importlib.util
import os
import time
import warnings
from pathlib import Path

import numpy as np
import torch

from navlearn.gnss import pz90, signals
from navlearn.gnss.ephemeris import KeplerEphemeris
from navlearn.gnss.glonass import glonass_state
from navlearn.gnss.kepler import kepler_state
from navlearn.logs.formats.rinex_navigation import read_navigation
from navlearn.logs.formats.rinex_orbits import VALID_FOR, glonass_ephemeris, kepler_ephemeris

FILE = Path("rinex_static") / "raw" / "reach-m2-01_raw_202306291111.nav"
DATA = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
NAMES = {"G": "GPS", "E": "Galileo", "C": "BeiDou", "J": "QZSS", "R": "GLONASS"}
LETTERS = {1: "G", 4: "R", 8: "E", 16: "J", 32: "C"}
SECOND = 1.0


def seconds(moment, week):
    """Return RTKLIB's time as seconds from the beginning of a week."""
    return moment.time - 315964800 - week * 604800 + moment.sec


class Peer:
    """Messages as RTKLIB read them from the same file."""

    def __init__(self, file, week):
        import pyrtklib

        self.library = pyrtklib
        self.read = pyrtklib.nav_t()
        pyrtklib.readrnx(str(file), 1, "", pyrtklib.obs_t(), self.read, pyrtklib.sta_t())
        self.messages = {}
        for k in range(self.read.n):
            message = self.read.eph[k]
            by_e5a = bool(message.code & 0b10)
            self.messages[self._key(message, week, by_e5a)] = message
        for k in range(self.read.ng):
            self.messages[self._key(self.read.geph[k], week, False)] = self.read.geph[k]
        self.position, self.clock = pyrtklib.Arr1Ddouble(6), pyrtklib.Arr1Ddouble(2)
        self.variance = pyrtklib.Arr1Ddouble(1)

    def _key(self, message, week, by_e5a):
        number = self.library.Arr1Dint(1)
        letter = LETTERS[self.library.satsys(message.sat, number)]
        toe = round(seconds(message.toe, week), 3)
        return f"{letter}{number[0]:02d}", toe, letter == "E" and by_e5a

    def state(self, message, after):
        """Return position (m) and clock (s) so long after the message's reference time."""
        at = self.library.timeadd(message.toe, after)
        move = self.library.geph2pos if hasattr(message, "taun") else self.library.eph2pos
        move(at, message, self.position, self.clock, self.variance)
        return [self.position[0], self.position[1], self.position[2]], self.clock[0]


def differences(state, message, times, peer, delay):
    """Return distances (m), differences of velocity (m/s) and of clocks (ns), a row per time."""
    rows = []
    for k, after in enumerate(times):
        position, clock = peer.state(message, float(after))
        before, _ = peer.state(message, float(after) - SECOND)
        later, _ = peer.state(message, float(after) + SECOND)
        velocity = (np.array(later) - before) / (2.0 * SECOND)
        rows.append(
            (
                np.linalg.norm(state.position[k].numpy() - position),
                np.linalg.norm(state.velocity[k].numpy() - velocity),
                1e9 * abs(float(state.clock[k]) / signals.SPEED_OF_LIGHT + delay - clock),
            )
        )
    return rows


def compared(letter, table, peer, points, **options):
    """Return the differences of a constellation and how many of its messages were compared."""
    rows, count = [], 0
    times = np.linspace(-VALID_FOR[letter], VALID_FOR[letter], points)
    for k in range(len(table)):
        row = table.iloc[k]
        by_e5a = letter == "E" and row["preference"] == 0.0
        message = peer.messages.get((row["satellite"], round(row["toe"], 3), by_e5a))
        if message is None:
            continue
        at = row["toe"] + torch.tensor(times)
        if letter == "R":
            state = glonass_state(glonass_ephemeris(table.iloc[[k]]), at, **options)
        else:
            state = kepler_state(kepler_ephemeris(table.iloc[[k]]), at)
        rows += differences(state, message, times, peer, row.get("group_delay", 0.0))
        count += 1
    return np.array(rows), count


def shown(name, rows, count):
    """Print a line of the table of differences."""
    worst, mean = rows.max(axis=0), np.sqrt((rows**2).mean(axis=0))
    print(
        f"{name:<26}{count:>9}{len(rows):>8}{worst[0]:>11.1e}{mean[0]:>11.1e}{worst[1]:>11.1e}"
        f"{worst[2]:>11.1e}{mean[2]:>11.1e}"
    )


def accuracy(told, peer, points):
    """Print how far both are apart, by constellation."""
    print(f"{'':<26}{'':>9}{'':>8}{'position, m':>22}{'m/s':>11}{'clock, ns':>22}")
    print(
        f"{'constellation':<26}{'messages':>9}{'times':>8}{'max':>11}{'RMS':>11}{'max':>11}"
        f"{'max':>11}{'RMS':>11}"
    )
    for letter in "GECJ":
        table = told.orbits
        table = table[table["satellite"].str[0] == letter] if len(table) else table
        if len(table):
            shown(NAMES[letter], *compared(letter, table, peer, points))
    if len(told.states):
        shown(NAMES["R"], *compared("R", told.states, peer, points))
        own = pz90.GRAVITATIONAL_CONSTANT, pz90.OBLATENESS
        pz90.GRAVITATIONAL_CONSTANT, pz90.OBLATENESS = 3.9860044e14, 1.0826257e-3
        try:
            # one time by one, for steps depend on the furthest
            options = {"longest_step": 60.0}
            rows, count = compared("R", told.states, peer, 2, **options)
        finally:
            pz90.GRAVITATIONAL_CONSTANT, pz90.OBLATENESS = own
        shown("GLONASS, RTKLIB's numbers", rows, count)


def least(run, repeats):
    """Return the shortest of some runs, s."""
    found = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        found.append(time.perf_counter() - begin)
    return min(found)


def speed(told, peer, batch, repeats):
    """Print satellites per second."""
    print(f"\n{'satellites per second':<26}{'batch':>9}{'this package':>14}{'RTKLIB':>12}")
    for name, table, propagate, ephemeris in (
        ("Keplerian", told.orbits, kepler_state, kepler_ephemeris),
        ("GLONASS, to half an hour", told.states, glonass_state, glonass_ephemeris),
    ):
        if not len(table):
            continue
        one_by_one = _peers_speed(table, peer, repeats)
        for size in (len(table), batch):
            rows = table.iloc[np.arange(size) % len(table)]
            message = ephemeris(rows)
            reach = 7200.0 if isinstance(message, KeplerEphemeris) else 1800.0
            at = message.toe + torch.linspace(-reach, reach, size, dtype=torch.float64)
            took = least(lambda p=propagate, m=message, t=at: p(m, t), repeats)
            print(f"{name:<26}{size:>9}{size / took:>14,.0f}{one_by_one:>12,.0f}")


def _peers_speed(table, peer, repeats):
    names = set(zip(table["satellite"], table["toe"].round(3), strict=True))
    found = [message for key, message in peer.messages.items() if key[:2] in names]
    furthest = 1800.0 if hasattr(found[0], "taun") else 7200.0
    reach = np.linspace(-furthest, furthest, len(found))

    def run():
        for message, after in zip(found, reach, strict=True):
            peer.state(message, float(after))

    return len(found) / least(run, repeats)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--file", type=Path, help="RINEX 3 navigation file")
    parser.add_argument("--week", type=int, default=2268, help="GPS week of the file")
    parser.add_argument("--time", type=float, default=385980.0, help="second of that week")
    parser.add_argument("--points", type=int, default=25, help="times per message")
    parser.add_argument("--batch", type=int, default=100_000, help="satellites at once")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    file = options.file or Path(os.environ.get("NAVLEARN_DATA") or DATA) / FILE
    if not file.is_file():
        print(f"{file}: no such file; see datasets/rinex_static.md")
        return
    if importlib.util.find_spec("pyrtklib") is None:
        print("pyrtklib is not installed; pip install pyrtklib")
        return
    warnings.simplefilter("ignore")
    time_of_file = (options.time, options.time)
    told = read_navigation([file], options.week, time_of_file, "GECJR")
    peer = Peer(file, options.week)
    with torch.no_grad():
        accuracy(told, peer, options.points)
        speed(told, peer, options.batch, options.repeats)


if __name__ == "__main__":
    main()
