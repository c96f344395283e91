"""The virtual hub; every driver of a device gets the same bytes."""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import serial
from tests.support.quick_cases import quick_cases

from gyrorig_daemon.emulator.emulated_rig import EmulatedDevice, EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import (
    BoardSettings,
    PtuFaults,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, PortHub
from gyrorig_protocol.board import HelloRequest, TimeRequest
from gyrorig_protocol.errors import DeviceError, MachineError

SECOND = 1_000_000_000
ORIGIN = 5 * SECOND
SETTINGS = RigSettings(
    seed=4,
    ptu=PtuSettings(baud=115200, command_time_ms=10.0, echo=False, verbose=False),
    boards=(BoardSettings(name="A"), BoardSettings(name="B", odr_hz=400.0, batch=4)),
)
# Seconds after power-up, port, bytes: moves, changes on the fly, polls, clock requests.
SCRIPT = [
    (0.10, "ptu", b"PS1500 TS700 "),
    (0.20, "ptu", b"PP2000 TP-400 "),
    (0.31, "board:A", TimeRequest(1, 2).encode()),
    (0.50, "ptu", b"BT "),
    (0.90, "ptu", b"PP-1000 "),
    (1.00, "board:B", HelloRequest().encode()),
    (1.20, "ptu", b"PS600 BT H "),
    (1.70, "ptu", b"PP3090 "),
    (1.71, "ptu", b"BT BT BT "),
    (4.00, "ptu", b"R "),
]
LENGTH_S = 15.0


def play(hub: PortHub, script: list[tuple[float, str, bytes]], end_s: float) -> list[Chunk]:
    chunks: list[Chunk] = []
    for at_s, port, data in [*script, (end_s, "", b"")]:
        deadline_ns = ORIGIN + round(at_s * SECOND)
        while (chunk := hub.read(deadline_ns)) is not None:
            chunks.append(chunk)
        if port:
            hub.write(port, data)
    return chunks


def test_only_a_command_that_moves_the_stage_asks_the_boards_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = EmulatedRig(SETTINGS, ORIGIN)
    hub = VirtualHub(rig)
    asked: list[str] = []
    for name, board in rig.boards.items():

        def next_output_ns(
            name: str = name, ask: Callable[[], int | None] = board.next_output_ns
        ) -> int | None:
            asked.append(name)
            return ask()

        monkeypatch.setattr(board, "next_output_ns", next_output_ns)

    def asked_after(data: bytes) -> list[str]:
        hub.read(hub.now_ns())  # a write and an output ask as well
        asked.clear()
        hub.write("ptu", data)
        hub.read(hub.now_ns())
        return asked

    play(hub, [], 0.1)
    assert asked_after(b"BT ") == []
    assert asked_after(b"PP2000 ") == ["A", "B"]
    assert asked_after(b"BT ") == []


def by_port(chunks: list[Chunk]) -> dict[str, bytes]:
    ports = {chunk.port for chunk in chunks}
    return {port: b"".join(c.data for c in chunks if c.port == port) for port in ports}


def test_one_seed_is_one_recording_and_another_is_another() -> None:
    first = play(VirtualHub(EmulatedRig(SETTINGS, ORIGIN)), SCRIPT, LENGTH_S)
    again = play(VirtualHub(EmulatedRig(SETTINGS, ORIGIN)), SCRIPT, LENGTH_S)
    assert first == again
    other = play(VirtualHub(EmulatedRig(replace(SETTINGS, seed=5), ORIGIN)), SCRIPT, LENGTH_S)
    assert by_port(first)["board:A"] != by_port(other)["board:A"]
    # Both sweeps at the end of the script end the moves with flags.
    assert by_port(first)["ptu"].endswith(b"!T!T!P!P*\r\n")


def test_a_rig_is_a_function_of_its_origin_only_by_a_shift() -> None:
    here = play(VirtualHub(EmulatedRig(SETTINGS, ORIGIN)), [], 2.0)
    rig = EmulatedRig(SETTINGS, ORIGIN + SECOND)
    hub = VirtualHub(rig)
    outputs = []
    while (chunk := hub.read(ORIGIN + 3 * SECOND)) is not None:
        outputs.append(chunk)
    assert by_port(here) == by_port(outputs)


def test_time_moves_only_in_read_and_never_back() -> None:
    hub = VirtualHub(EmulatedRig(SETTINGS, ORIGIN))
    assert hub.now_ns() == ORIGIN
    stamp = hub.write("ptu", b"PP ")
    assert stamp.before_ns == stamp.after_ns == hub.now_ns() == ORIGIN
    last_ns = ORIGIN
    for _ in range(200):
        chunk = hub.read(ORIGIN + SECOND)
        assert chunk is not None
        assert chunk.received_ns == hub.now_ns() >= last_ns
        last_ns = hub.now_ns()
    while hub.read(ORIGIN + SECOND) is not None:
        pass
    assert hub.now_ns() == ORIGIN + SECOND
    assert hub.read(ORIGIN) is None
    assert hub.now_ns() == ORIGIN + SECOND


def test_unknown_and_closed_ports_are_refused() -> None:
    hub = VirtualHub(EmulatedRig(SETTINGS, ORIGIN))
    with pytest.raises(DeviceError, match="board:C"):
        hub.write("board:C", b"")
    hub.close()
    hub.close()
    assert hub.read(ORIGIN + SECOND) is None
    with pytest.raises(DeviceError):
        hub.write("ptu", b"PP ")


def test_a_pulled_cable_is_a_hang_up() -> None:
    hub = VirtualHub(EmulatedRig(SETTINGS, ORIGIN))
    hub.unplug("board:A", ORIGIN + SECOND)
    chunks = play(hub, [], 2.0)
    of_a = [chunk for chunk in chunks if chunk.port == "board:A"]
    assert of_a[-1] == Chunk("board:A", ORIGIN + SECOND, b"", PortChange.GONE, "it was unplugged")
    assert not hub.is_up("board:A")
    assert all(chunk.data for chunk in of_a[:-1])
    assert max(c.received_ns for c in chunks if c.port == "board:B") > ORIGIN + 1.9 * SECOND
    with pytest.raises(DeviceError, match="the emulator has disconnected"):
        hub.write("board:A", b"x")


def test_a_cable_that_is_plugged_in_again() -> None:
    hub = VirtualHub(EmulatedRig(SETTINGS, ORIGIN))
    hub.unplug("board:A", ORIGIN + SECOND, ORIGIN + 3 * SECOND // 2)
    of_a = [chunk for chunk in play(hub, [], 2.0) if chunk.port == "board:A"]
    changes = [chunk for chunk in of_a if chunk.change is not None]
    assert [chunk.change for chunk in changes] == [PortChange.GONE, PortChange.BACK]
    gone_ns, back_ns = (chunk.received_ns for chunk in changes)
    assert not any(gone_ns <= c.received_ns < back_ns for c in of_a if c.data)
    assert of_a[-1].data
    hub.reopen("board:A")
    changed = [c.change for c in play(hub, [], 2.1) if c.change is not None]
    assert changed == [PortChange.GONE, PortChange.BACK]
    assert hub.is_up("board:A")


def drive(device: EmulatedDevice, script: list[tuple[int, bytes]], looks_ns: list[int]) -> bytes:
    """Drive a device as a server does: look when it happens to wake up, write when told."""
    got = b""
    events = sorted([(at, None) for at in looks_ns] + list(script), key=lambda e: e[0])
    for at_ns, data in events:
        got += b"".join(d for _, d in device.take_output(at_ns))
        if data is not None:
            device.receive(data, at_ns)
    return got


@pytest.mark.parametrize("seed", quick_cases(range(6), [0]))
def test_bytes_do_not_depend_on_when_a_device_is_looked_at(seed: int) -> None:
    lossy = PtuSettings(command_time_ms=20.0, faults=PtuFaults(lose_steps_at_s=0.3, lost_steps=60))
    settings = replace(SETTINGS, seed=seed, ptu=lossy)
    rng = np.random.default_rng(seed)
    results = []
    for looks in (15_000, 400, 0):
        rig = EmulatedRig(settings, ORIGIN)
        looks_ns = rng.integers(ORIGIN, ORIGIN + 15 * SECOND, looks).tolist()
        script = {
            port: [(ORIGIN + round(s * SECOND), d) for s, p, d in SCRIPT if p == port]
            for port in rig.devices
        }
        # The unit first: what a board feels of a move is known when the board is looked at.
        results.append(
            {
                port: drive(device, script[port], [*looks_ns, ORIGIN + 15 * SECOND])
                for port, device in rig.devices.items()
            }
        )
    assert results[0] == results[1] == results[2]


def noting(
    receive: Callable[[bytes, int], None], port: str, line_times: list[tuple[int, str, bytes]]
) -> Callable[[bytes, int], None]:
    def noted(data: bytes, at_ns: int) -> None:
        line_times.append((at_ns, port, data))
        receive(data, at_ns)

    return noted


def test_a_server_that_interleaves_gets_what_the_virtual_hub_gets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same line times on both: the hub's write delay is the only difference, so taken out."""
    hub_rig, server_rig = EmulatedRig(SETTINGS, ORIGIN), EmulatedRig(SETTINGS, ORIGIN)
    line_times: list[tuple[int, str, bytes]] = []
    hub = VirtualHub(hub_rig)
    for port, device in hub_rig.devices.items():
        monkeypatch.setattr(device, "receive", noting(device.receive, port, line_times))
    from_hub = by_port(play(hub, SCRIPT, LENGTH_S))

    devices = server_rig.devices
    got = dict.fromkeys(devices, b"")
    rng = np.random.default_rng(1)
    now_ns, end_ns = ORIGIN, ORIGIN + round(LENGTH_S * SECOND)
    while now_ns < end_ns:
        # Wake at most 20 ms later, but for what has to be written.
        due = [at for at, _, _ in line_times if at > now_ns]
        now_ns = min([now_ns + int(rng.integers(10_000, 20_000_000)), *due[:1]])
        for port, device in devices.items():
            got[port] += b"".join(d for _, d in device.take_output(now_ns))
        for at_ns, port, data in line_times:
            if at_ns == now_ns:
                devices[port].receive(data, at_ns)
    for port, data in from_hub.items():
        assert got[port][: len(data)] == data
        assert len(got[port]) - len(data) < 600


def test_a_pty_gives_the_bytes_of_the_virtual_hub() -> None:
    """In real time, for a script whose answers hold no time: queries, moves that are awaited."""
    settings = RigSettings(seed=1, ptu=PtuSettings(baud=115200), boards=(BoardSettings(name="A"),))
    script = [b"V ", b"PR ", b"PS2000 ", b"PP200 ", b"A ", b"PP ", b"TP9999 ", b"ED ", b"FT ",
              b"PO-50 A PP\r", b"XYZ ", b"TX "]  # fmt: skip
    hub = VirtualHub(EmulatedRig(settings, ORIGIN))
    expected = b""
    for k, command in enumerate(script):
        hub.write("ptu", command)
        while (chunk := hub.read(ORIGIN + (k + 1) * SECOND)) is not None:
            expected += chunk.data if chunk.port == "ptu" else b""

    server = PtyServer(EmulatedRig(settings, raw_now_ns()))
    stop = threading.Event()
    thread = threading.Thread(target=server.run, args=(stop.is_set,))
    thread.start()
    try:
        with serial.Serial(server.paths["ptu"], 115200, timeout=60.0) as port:
            # Opened, so that from now on it is delivered to.
            deadline = time.monotonic() + 60.0
            got = b""
            for command in script:
                port.write(command)
                replies = command.count(b" ") + command.count(b"\r")
                for _ in range(replies):
                    line = port.readline()
                    got += line if line != b"\n" else line + port.readline()
                assert time.monotonic() < deadline
    finally:
        stop.set()
        thread.join()
        server.close()
        server.close()
    assert got == expected


def test_links_name_the_ports(tmp_path: Path) -> None:
    rig = EmulatedRig(replace(SETTINGS, boards=SETTINGS.boards[:1]), raw_now_ns())
    server = PtyServer(rig, tmp_path / "ports")
    assert (tmp_path / "ports" / "ptu").resolve().as_posix() == server.paths["ptu"]
    assert (tmp_path / "ports" / "board-A").is_symlink()
    server.close()
    assert list((tmp_path / "ports").iterdir()) == []


class Ear:
    """A device that only listens."""

    def __init__(self) -> None:
        self.heard = b""

    def receive(self, data: bytes, at_ns: int) -> None:
        self.heard += data

    def next_output_ns(self) -> int | None:
        return None

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        return []


class Ears:
    """A rig of them."""

    def __init__(self, *names: str) -> None:
        self.devices = {name: Ear() for name in names}


def test_a_client_that_writes_and_leaves_is_heard() -> None:
    rig = Ears("ptu")
    server = PtyServer(cast(EmulatedRig, rig))
    turns = iter(range(100))
    client = os.open(server.paths["ptu"], os.O_RDWR | os.O_NOCTTY)
    os.write(client, b" H ")
    os.close(client)  # before the server has looked even once
    server.run(lambda: rig.devices["ptu"].heard != b"" or next(turns) == 99)
    client = os.open(server.paths["ptu"], os.O_RDWR | os.O_NOCTTY)
    server.run(lambda: next(turns) > 3)  # now it knows of the client
    os.write(client, b"V ")
    os.close(client)
    server.run(lambda: len(rig.devices["ptu"].heard) > 3 or next(turns) == 99)
    server.close()
    assert rig.devices["ptu"].heard == b" H V "


def test_links_of_a_later_emulator_are_left_to_it(tmp_path: Path) -> None:
    first = PtyServer(cast(EmulatedRig, Ears("ptu")), tmp_path)
    second = PtyServer(cast(EmulatedRig, Ears("ptu")), tmp_path)
    first.close()
    assert str((tmp_path / "ptu").readlink()) == second.paths["ptu"]
    second.close()
    assert list(tmp_path.iterdir()) == []


def test_links_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MachineError, match="cannot create links"):
        PtyServer(cast(EmulatedRig, Ears("ptu")), tmp_path / "file" / "deeper")
