"""The emulated unit's commands, timing and faults, byte for byte."""

import itertools
from dataclasses import replace

import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import PtuFaults, PtuSettings, RigSettings
from gyrorig_daemon.emulator.ptu import EmulatedPtu

E46 = PtuSettings(echo=False)
D46 = replace(E46, dialect="d46")
TERSE = replace(E46, verbose=False)


class Line:
    """A unit and a time; each exchange waits for what comes back."""

    def __init__(self, settings: PtuSettings) -> None:
        rig = EmulatedRig(RigSettings(seed=1, ptu=settings, boards=()), 0)
        assert isinstance(rig.ptu, EmulatedPtu)
        self.unit = rig.ptu
        self.stage = rig.stage
        self.now_ns = 1_000_000

    def send(self, data: bytes) -> None:
        self.unit.receive(data, self.now_ns)

    def drain(self) -> bytes:
        """Everything that comes, the clock moving on to its end."""
        got = b""
        while (due_ns := self.unit.next_output_ns()) is not None:
            self.now_ns = max(self.now_ns, due_ns)
            got += b"".join(data for _, data in self.unit.take_output(due_ns))
        return got

    def until(self, seconds: float) -> bytes:
        self.now_ns += round(seconds * 1e9)
        return b"".join(data for _, data in self.unit.take_output(self.now_ns))

    def ask(self, command: str) -> str:
        self.send(command.encode() + b" ")
        return self.drain().decode()


COMMON = [
    ("PP", "* Current Pan position is 0"),
    ("TP", "* Current Tilt position is 0"),
    ("pp", "* Current Pan position is 0"),
    ("PN", "* Minimum Pan position is -3090"),
    ("PX", "* Maximum Pan position is 3090"),
    ("TN", "* Minimum Tilt position is -907"),
    ("TX", "* Maximum Tilt position is 604"),
    ("PD", "* Current Pan speed is 0 positions/sec"),
    ("PU", "* Maximum Pan speed is 2902 positions/sec"),
    ("TL", "* Minimum Tilt speed is 31 positions/sec"),
    ("PB", "* Current Pan base speed is 1000 positions/sec"),
    ("PA", "* Current Pan acceleration is 2000 positions/sec^2"),
    ("PP4000", "! Maximum allowable Pan position is 3090"),
    ("TP-950", "! Minimum allowable Tilt position is -907"),
    ("TO605", "! Maximum allowable Tilt position is 604"),
    ("PS3000", "! Pan speed cannot exceed 2902 positions/sec"),
    ("TS30", "! Motor speed cannot be less than 31 pos/sec"),
    ("XYZ", "! Illegal Command Entered"),
    ("PR5", "! Illegal Command Entered"),
    ("PP1x", "! Illegal Command Entered"),
    ("PS900", "*"),
    ("E", "* Echoing OFF"),
    ("F", "* ASCII verbose mode"),
    ("L", "* Limit bounds are ENABLED (soft limits enabled)"),
    ("LD", "*"),
    ("PH", "* REGULAR"),
    ("PHL", "*"),
    ("WP", "* Pan step mode is HALF"),
    ("I", "*"),
    ("CI", "*"),
    ("H", "*"),
    ("A", "*"),
]
BY_DIALECT = [
    (E46, "PR", "* 185.142857 seconds arc per position"),
    (D46, "PR", "* 185.1428 seconds arc per Pan position"),
    (E46, "PS", "* Target Pan speed is 1000 positions/sec"),
    (D46, "PS", "* Desired Pan speed is 1000 positions/sec"),
    (E46, "PO", "* Target Pan position is 0"),
    (D46, "PO", "* Current Pan position is 0"),
    (E46, "C", "* PTU is in Independent Mode"),
    (D46, "C", "* PTU is in independent (default) speed control mode"),
    (E46, "B", "* P(0,0) S(0,0)"),
    (D46, "B", "! Illegal Command Entered"),
    (D46, "BT", "! Illegal Command Entered"),
    (D46, "CNT", "! Illegal Command Entered"),
    (E46, "CNF", "* 90000000"),
    (D46, "CNF", "! Illegal Command Entered"),
    (E46, "VM", "* PTU-E46-17.5"),
    (E46, "VS", "* E46-0001"),
    (D46, "O", "* Input 30 VDC @ 77 degF"),
    (E46, "O", "* 30.0,77,79,78"),
]


@pytest.mark.parametrize("settings", [E46, D46], ids=["e46", "d46"])
@pytest.mark.parametrize(("command", "reply"), COMMON)
def test_common_exchanges(settings: PtuSettings, command: str, reply: str) -> None:
    assert Line(settings).ask(command) == reply + "\r\n"


@pytest.mark.parametrize(("settings", "command", "reply"), BY_DIALECT)
def test_exchanges_by_dialect(settings: PtuSettings, command: str, reply: str) -> None:
    assert Line(settings).ask(command) == reply + "\r\n"


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("PP", "* 0"),
        ("PR", "* 185.142857"),
        ("PA", "* 2000"),
        ("PH", "* REG"),
        ("PP4000", "! Maximum allowable Pan position is 3090"),
        ("C", "* PTU is in Independent Mode"),
        ("E", "* Echoing OFF"),
    ],
)
def test_terse_drops_the_words_but_not_of_modes_and_errors(command: str, reply: str) -> None:
    assert Line(TERSE).ask(command) == reply + "\r\n"


def test_words_of_another_firmware() -> None:
    settings = replace(E46, acceleration_text="sec/sec")
    assert Line(settings).ask("TA") == "* Current Tilt acceleration is 2000 positions/sec/sec\r\n"


def test_echo_comes_back_in_front_of_the_reply() -> None:
    line = Line(PtuSettings())
    assert line.ask("PP") == "PP * Current Pan position is 0\r\n"
    assert line.ask("E") == "E * Echoing ON\r\n"
    assert line.ask("ED") == "ED *\r\n"
    assert line.ask("FT") == "*\r\n"
    assert line.ask("PP") == "* 0\r\n"


def test_delimiters() -> None:
    line = Line(TERSE)
    line.send(b"   \r\n  ")
    assert line.drain() == b""
    line.send(b"PP\r")
    assert line.drain() == b"\n* 0\r\n"
    line.send(b"PP\n")
    assert line.drain() == b"* 0\r\n"
    line = Line(replace(TERSE, leading_lf_on_cr=False))
    line.send(b"PP\rTP\r")
    assert line.drain() == b"* 0\r\n* 0\r\n"


def test_a_line_without_end_is_refused_and_forgotten() -> None:
    line = Line(TERSE)
    line.send(b"P" * 100_000)
    assert line.drain() == b""
    assert line.ask("") == "! Illegal Command Entered\r\n"
    assert line.ask("PP") == "* 0\r\n"


@pytest.mark.parametrize(
    ("baud", "command_ms"), [(9600, 1.0), (9600, 20.0), (9600, 100.0), (115200, 10.0)]
)
def test_bytes_and_command_take_their_time(baud: int, command_ms: float) -> None:
    line = Line(replace(TERSE, baud=baud, command_time_ms=command_ms))
    start_ns = line.now_ns
    line.send(b"PP ")
    byte_ns = 10_000_000_000 // baud
    first_ns = line.unit.next_output_ns()
    assert first_ns == start_ns + 3 * byte_ns + round(command_ms * 1e6) + byte_ns
    assert line.unit.take_output(first_ns) == [(first_ns, b"*")]
    assert line.drain() == b" 0\r\n"
    assert line.now_ns == first_ns + 4 * byte_ns


def test_the_count_is_taken_inside_the_command_time() -> None:
    settings = replace(TERSE, baud=115200, command_time_ms=20.0, sample_fraction=0.25)
    line = Line(settings)
    line.ask("PS1000")
    line.send(b"PP3000 ")
    line.drain()
    sent_ns = line.now_ns + 200_000_000
    line.now_ns = sent_ns
    reply = line.ask("PP")
    acted_ns = sent_ns + 3 * 86_805 + 5_000_000
    assert reply == f"* {line.stage.pan.count(acted_ns * 1e-9)}\r\n"


def test_commands_wait_for_each_other() -> None:
    line = Line(replace(TERSE, command_time_ms=100.0, baud=115200))
    start_ns = line.now_ns
    line.send(b"PP TP PP ")
    assert line.drain() == b"* 0\r\n" * 3
    assert line.now_ns == pytest.approx(start_ns + 300_000_000 + 8 * 86_805, abs=300_000)


def test_moves_count_up_and_await_holds_everything_back() -> None:
    line = Line(TERSE)
    line.send(b"PS500 PP1000 ")
    line.until(1.0)
    line.send(b"PP ")
    assert 480 < int(line.until(0.05).split()[1]) < 500
    line.send(b"A PP ")
    assert line.until(0.8) == b""
    assert line.drain() == b"*\r\n* 1000\r\n"


def test_offset_counts_from_where_the_axis_is() -> None:
    line = Line(TERSE)
    line.send(b"PS500 PP1000 ")
    line.until(1.0)
    line.send(b"PO100 PO ")
    target = int(line.drain().split()[-1])
    assert 580 < target < 610


def test_halt_stops_within_a_step_below_base_speed() -> None:
    line = Line(TERSE)
    line.send(b"PS500 PP1000 ")
    line.until(1.0)
    line.send(b"H ")
    line.drain()
    line.until(0.1)
    stopped = line.ask("PP")
    line.until(3.0)
    assert line.ask("PP") == stopped
    assert 480 < int(stopped.split()[1]) < 510


def test_slaved_targets_wait_and_start_together() -> None:
    line = Line(TERSE)
    assert line.ask("S") == "*\r\n"
    assert line.ask("PP400") == "*\r\n"
    assert line.ask("TP-300") == "*\r\n"
    line.until(2.0)
    assert line.ask("PP") == "* 0\r\n"
    assert line.ask("A") == "*\r\n"
    assert line.ask("B") == "* P(400,-300) S(0,0)\r\n"


def test_velocity_mode_runs_to_a_limit_and_zero_halts() -> None:
    line = Line(TERSE)
    line.ask("CV")
    line.ask("PS-500")
    line.until(1.0)
    assert "S(-500,0)" in line.ask("B")
    line.ask("PS0")
    line.until(0.1)
    assert "S(0,0)" in line.ask("B")
    line.ask("PS2000")
    line.until(10.0)
    assert line.ask("B") == "* P(3090,0) S(0,0)\r\n"
    assert line.ask("CI") == "*\r\n"


def test_four_numbers_at_once() -> None:
    line = Line(TERSE)
    assert line.ask("B300,-200,800,400") == "*\r\n"
    assert line.ask("A") == "*\r\n"
    assert line.ask("B") == "* P(300,-200) S(0,0)\r\n"
    assert line.ask("B300,-2000,800,400") == "! Minimum allowable Tilt position is -907\r\n"
    assert line.ask("PS") == "* 800\r\n"


def test_tables_are_recomputed_at_rest() -> None:
    line = Line(replace(TERSE, recompute_s=3.0))
    line.send(b"PS500 PP500 ")
    line.drain()
    start_ns = line.now_ns
    assert line.ask("PA4000") == "*\r\n"
    assert line.now_ns - start_ns == pytest.approx(4.0e9, abs=0.05e9)
    assert line.ask("PA") == "* 4000\r\n"


def test_reset_sweeps_tilt_then_pan_and_glues_its_flags_to_the_status() -> None:
    line = Line(replace(TERSE, homed=False, power_up_pan_steps=50, power_up_tilt_steps=-20))
    assert line.ask("PN") == "* 0\r\n"
    assert line.ask("PP100") == "! Maximum allowable Pan position is 0\r\n"
    assert line.ask("TP-1") == "! Minimum allowable Tilt position is 0\r\n"
    start_ns = line.now_ns
    assert line.ask("R") == "!T!T!P!P*\r\n"
    # Tilt 2 x 1511 + 2 x 302 and pan 4 x 3098 steps, at 2000 steps/s at most.
    assert 6e9 < line.now_ns - start_ns < 12e9
    assert line.ask("PN") == "* -3090\r\n"
    assert line.ask("PP") == "* 0\r\n"
    angle = line.stage.pan.angles_rad(line.now_ns * 1e-9, 1.0, 1)[0]
    assert angle == pytest.approx(0.0, abs=1e-12)


def test_power_up_sweep_ends_in_the_banner() -> None:
    line = Line(replace(TERSE, homed=False, sweep_at_power_up=True, banner=True))
    first = line.drain()
    assert first.startswith(b"!T!T!P!P\r\n### PAN-TILT CONTROLLER")
    assert first.endswith(b"\r\n*")
    assert line.ask("PX") == "* 3090\r\n"


def test_lost_steps_show_as_a_flag_at_the_end_of_travel() -> None:
    faults = PtuFaults(lose_steps_at_s=0.5, lost_steps=40)
    line = Line(replace(TERSE, faults=faults))
    line.until(1.0)
    line.send(b"PP3090 ")
    replies = line.until(0.2)
    while line.unit.next_output_ns() is not None:
        replies += line.drain()
    assert replies == b"*\r\n!P"
    # 3090 + 8 is the stop; 40 steps were lost on the way there.
    assert line.ask("PP") == "* 3058\r\n"


def test_a_flag_goes_out_in_the_middle_of_a_reply() -> None:
    line = Line(replace(E46, faults=PtuFaults(lose_steps_at_s=0.0, lost_steps=40)))
    line.send(b"PS1000 PP3090 ")
    line.drain()
    end_ns = round(line.stage.pan.rests_at_s() * 1e9)
    other = Line(replace(E46, faults=PtuFaults(lose_steps_at_s=0.0, lost_steps=40)))
    other.send(b"PS1000 PP3090 ")
    other.until(1.0)
    other.now_ns = end_ns - 15_000_000
    other.send(b"TX ")
    got = other.until(1.0)
    assert b"!P" in got[2:-4]
    assert got.replace(b"!P", b"") == b"* Maximum Tilt position is 604\r\n"


def test_step_mode_changes_the_unit_of_everything() -> None:
    line = Line(TERSE)
    assert line.ask("WPQ") == "!P!P*\r\n"
    assert line.ask("PR") == "* 92.571429\r\n"
    assert line.ask("PX") == "* 6180\r\n"
    line.ask("PP1000")
    line.ask("A")
    assert line.ask("PP") == "* 1000\r\n"
    angle = line.stage.pan.angles_rad(line.now_ns * 1e-9, 1.0, 1)[0]
    assert angle * 206264.806 == pytest.approx(1000 * 92.5714286, rel=1e-6)


def test_user_limits() -> None:
    line = Line(TERSE)
    assert line.ask("PNU100") == "! Maximum allowable Pan position is 0\r\n"
    assert line.ask("PNU-100") == "*\r\n"
    assert line.ask("PXU200") == "*\r\n"
    assert line.ask("LU") == "*\r\n"
    assert line.ask("PP201") == "! Maximum allowable Pan position is 200\r\n"
    assert line.ask("PP200") == "*\r\n"


def test_counter_runs_at_its_rate_and_wraps() -> None:
    line = Line(replace(TERSE, baud=115200))
    readings = []
    for _ in range(60):
        line.until(1.0)
        readings.append((line.now_ns, int(line.ask("BT").split()[-1])))
    ticks, wraps = 0, 0
    for (_, before), (_, after) in itertools.pairwise(readings):
        ticks += (after - before) % 2**32
        wraps += after < before
    seconds = (readings[-1][0] - readings[0][0]) * 1e-9
    assert wraps in (1, 2)
    assert ticks / seconds == pytest.approx(90e6, rel=60e-6)


def test_baud_changes_after_its_reply() -> None:
    line = Line(TERSE)
    assert line.ask("@(115200,0,F)") == "*\r\n"
    start_ns = line.now_ns
    assert line.ask("PP") == "* 0\r\n"
    assert line.now_ns - start_ns < 2_000_000
    assert line.ask("@(1234,0,F)").startswith("!")


def test_a_unit_with_an_address_is_silent_until_it_is_called() -> None:
    line = Line(replace(TERSE, unit_id=5))
    assert line.ask("PP") == ""
    assert line.ask("_4") == ""
    assert line.ask("_5") == "*\r\n"
    assert line.ask("PP") == "* 0\r\n"
    assert line.ask("_0") == ""
    assert line.ask("PP100") == ""
    line.until(1.0)
    assert line.ask("_5") == "*\r\n"
    assert line.ask("PP") == "* 100\r\n"
    assert line.ask("U0") == "*\r\n"


def test_faults_of_the_line() -> None:
    assert Line(replace(TERSE, faults=PtuFaults(silent=True))).ask("PP") == ""
    line = Line(replace(TERSE, faults=PtuFaults(lose_byte_every=2)))
    assert [len(line.ask("PP")) for _ in range(4)] == [5, 4, 5, 4]
    line = Line(replace(TERSE, faults=PtuFaults(error_every=2)))
    assert [line.ask("PP")[0] for _ in range(4)] == ["*", "!", "*", "!"]
    line = Line(replace(TERSE, faults=PtuFaults(garbage_every=1)))
    line.send(b"PP ")
    assert line.drain().endswith(b"* 0\r\n")


def test_angle_follows_the_sign_of_the_unit() -> None:
    line = Line(replace(TERSE, pan_sign=-1))
    line.ask("PP100")
    line.ask("A")
    assert line.stage.pan.angles_rad(line.now_ns * 1e-9, 1.0, 1)[0] < 0.0
