"""Record a synthetic fleet: an emulated rig for every session, in simulated time.

    OUT/spool/*.mcap      the recordings, broken ones among them
       /boards.csv        board, lot, site: what a fleet's owner knows
       /hidden.json       what is hidden, and which recordings are broken and how

A recording that is there is left alone: a run can go on where it was stopped.

Run: python tests/bench/fleet/make.py --out OUT --boards 24 --nights 6 --rig-drift 1:2:4e-4
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.bench.fleet.nights import (
    Broken,
    FleetDraw,
    Session,
    name_of,
    sessions_of,
    settings_of,
    truth_of,
)

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.program import parse_program

ROOT = Path(__file__).resolve().parents[3]
ORIGIN_NS = 5_000_000_000  # power-up, on the rig's raw clock
FIRST_NIGHT_NS = 1_767_232_800_000_000_000  # 2026-01-01 02:00 UTC
DAY_NS, APART_NS = 86_400_000_000_000, 200_000_000_000


def record(draw: FleetDraw, session: Session, program: str, path: Path) -> None:
    """Hold a session and put its recording at `path`, spoilt where it is to be."""
    rig = EmulatedRig(settings_of(draw, session), ORIGIN_NS, truth_of(draw, session))
    hub = VirtualHub(rig)
    capture = CaptureClock(_begin_ns(session), hub.now_ns())

    def read_host() -> HostClocks:
        now_ns = hub.now_ns()
        return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

    around = SessionEnvironment(
        capture, read_host, threaded_writer=False, host="emulated", seed=rig.settings.seed
    )
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        order = _order(draw, session, program, Path(folder))
        made = record_session(hub, order, around)
        if session.broken is not None:
            spoil(made, session.broken)
        made.replace(path)


def _begin_ns(session: Session) -> int:
    return FIRST_NIGHT_NS + DAY_NS * session.night + APART_NS * session.of_night


def _order(draw: FleetDraw, session: Session, program: str, out: Path) -> SessionRequest:
    name = f"{'static' if session.broken == 'at_rest' else program}.yaml"
    config_text = dump_yaml(
        {
            "schema": "gyrorig/rig/1",
            "rig": f"rig-{session.rig}",
            "site": {"gravity_m_s2": 9.80665},
            "ptu": {"port": "emulated", "baud": 115200},
            "boards": [
                {"id": name_of(board), "port": "emulated", "baud": 460800}
                for board in session.boards
            ],
            "emulator": {"odr_hz": int(draw.odr_hz)},
        }
    ).encode()
    program_text = (ROOT / "config" / "programs" / name).read_bytes()
    return SessionRequest(
        config=parse_rig(config_text, "rig.yaml"),
        config_text=config_text,
        program=parse_program(program_text, name),
        program_text=program_text,
        out_dir=out,
        session=f"n{session.number:05d}",
    )


def spoil(path: Path, how: Broken) -> None:
    """Break a recording."""
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 20])
    elif how == "foreign":
        path.write_bytes(b"PK\x03\x04" + bytes(range(256)) * 40)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "garbled":
        spoilt = bytearray(data)
        for at in range(len(data) // 10, len(data), 997):
            spoilt[at] ^= 0xFF
        path.write_bytes(bytes(spoilt))


def make(out: Path, draw: FleetDraw, program: str) -> int:
    """Record what is not there yet; return how many."""
    spool = out / "spool"
    spool.mkdir(parents=True, exist_ok=True)
    lines = [
        f"{name_of(n)},lot-{draw.lot_of(n)},"
        f"{'north' if draw.rig_of(n) < draw.rigs / 2 else 'south'}"
        for n in range(draw.boards)
    ]
    (out / "boards.csv").write_text("\n".join(["board,lot,site", *lines]) + "\n")
    sessions = list(sessions_of(draw))
    hidden = {
        "draw": asdict(draw),
        "program": program,
        "broken": {_name(session): session.broken for session in sessions if session.broken},
    }
    (out / "hidden.json").write_text(json.dumps(hidden, indent=1))
    made, begun_s = 0, time.monotonic()
    for session in sessions:
        path = spool / _name(session)
        if not path.exists():
            record(draw, session, program, path)
            made += 1
            each_s = (time.monotonic() - begun_s) / made
            sys.stderr.write(f"\r{session.number + 1} of {len(sessions)}, {each_s:.2f} s each ")
    sys.stderr.write("\n")
    return made


def _name(session: Session) -> str:
    """Return the name that the daemon gives a recording."""
    begun = datetime.fromtimestamp(_begin_ns(session) * 1e-9, UTC)
    return f"{begun:%Y%m%dT%H%M%SZ}_rig-{session.rig}_n{session.number:05d}.mcap"


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a fleet."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--program", default="quick", help="a name in config/programs")
    for name in ("boards", "nights", "rigs", "lots", "at-once", "seed"):
        parser.add_argument(f"--{name}", type=int, help="see FleetDraw")
    parser.add_argument("--odr", type=float, choices=(100.0, 200.0, 400.0, 800.0), default=100.0)
    parser.add_argument("--measured", type=float, default=1.0, help="share of boards on a night")
    parser.add_argument("--broken", type=float, default=0.0, help="share of broken recordings")
    parser.add_argument("--bad-lot", metavar="LOT:SCALE")
    parser.add_argument("--rig-drift", metavar="RIG:NIGHT:RAD")
    parser.add_argument("--board-drift", metavar="BOARD:NIGHT:SCALE")
    parser.add_argument("--constant", type=float, metavar="SHARE")
    options = parser.parse_args(arguments)
    numbers = ("boards", "nights", "rigs", "lots", "at_once", "seed")
    given = {n: getattr(options, n) for n in numbers if getattr(options, n) is not None}
    draw = FleetDraw(
        **given,
        odr_hz=options.odr,
        measured=options.measured,
        broken=options.broken,
        constant=options.constant,
    )
    if options.bad_lot is not None:
        lot, scale = options.bad_lot.split(":")
        draw = replace(draw, bad_lot=(int(lot), float(scale)))
    if options.rig_drift is not None:
        draw = replace(draw, rig_drift=_drift(options.rig_drift))
    if options.board_drift is not None:
        draw = replace(draw, board_drift=_drift(options.board_drift))
    sys.stdout.write(f"{make(options.out, draw, options.program)} recordings made\n")


def _drift(text: str) -> tuple[int, int, float]:
    which, first, a_night = text.split(":")
    return int(which), int(first), float(a_night)


if __name__ == "__main__":
    main()
