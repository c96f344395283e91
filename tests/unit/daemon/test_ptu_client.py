"""The client of the pan-tilt unit, tested against a scripted unit with faulty replies."""

from collections.abc import Callable
from itertools import pairwise
from types import MappingProxyType

import pytest

from gyrorig_daemon.config import PTU_PORT, PtuPort
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, WriteTimes
from gyrorig_daemon.links.pump import Pump, StopFlag, StopRequestedError
from gyrorig_daemon.motion import Exchange, Homing, PositionPoller, Unit, open_unit
from gyrorig_daemon.motion.directed_perception.ptu_client import PtuClient
from gyrorig_daemon.motion.directed_perception.unit_setup import identify_unit
from gyrorig_daemon.motion.drivers.directed_perception import DirectedPerceptionUnit
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import PtuSettings
from gyrorig_protocol.ptu import Axis, Quantity, assign_quantity, query_quantity
from gyrorig_protocol.ptu.ptu_commands import HALT_BOTH_AXES, QUERY_VERSION

MS = 1_000_000
Answers = Callable[[str], bytes | None]


class ScriptedHub:
    """A unit that answers a command as told, 5 ms later, under a clock of its own."""

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._now_ns = 0
        self._due: list[Chunk] = []
        self.heard: list[str] = []
        self.delays_s: dict[str, list[float]] = {}  # of the next answers to a command
        self.slow_s = 0.0  # of every answer

    def now_ns(self) -> int:
        return self._now_ns

    def write(self, port: str, data: bytes) -> WriteTimes:
        before_ns = self._now_ns
        self._now_ns += MS // 10
        for command in data.decode().split():
            self.heard.append(command)
            answer = self._answers(command)
            if answer is not None:
                change = None if answer else PortChange.GONE
                delays_s = self.delays_s.get(command, [])
                delay_s = delays_s.pop(0) if delays_s else self.slow_s
                due_ns = self._now_ns + 5 * MS + round(delay_s * 1e9)
                last_ns = self._due[-1].received_ns if self._due else 0  # one after the other
                self._due.append(Chunk(port, max(due_ns, last_ns), answer, change))
        return WriteTimes(before_ns, self._now_ns)

    def read(self, deadline_ns: int) -> Chunk | None:
        if self._due and self._due[0].received_ns <= deadline_ns:
            chunk = self._due.pop(0)
            self._now_ns = max(self._now_ns, chunk.received_ns)
            return chunk
        self._now_ns = max(self._now_ns, deadline_ns)
        return None

    def is_up(self, port: str) -> bool:
        return port == PTU_PORT

    def reopen(self, port: str) -> None:
        raise AssertionError(port)

    def close(self) -> None:
        return


class ScriptedUnit:
    """A D46 that is homed, or not, in terse mode without echo; `odd` overrides answers."""

    WORDS = MappingProxyType(
        {
            "V": b"* Pan-Tilt Controller v2.12.9r1(D46 C14/E)\r\n",
            "R": b"!T!T!P!P*\r\n",
            "PR": b"* 185.142857\r\n",
            "TR": b"* 185.142857\r\n",
        }
        | dict.fromkeys(("CNF", "VM", "VS", "BT"), b"! Illegal Command Entered\r\n")
        | dict.fromkeys(("L", "O", "WP", "WT", "PH", "PM", "TH", "TM"), b"* REG\r\n")
    )

    def __init__(self, homed: bool = True) -> None:
        self.values = {"PU": 2902, "TU": 2902, "PB": 1000, "TB": 1000, "PA": 2000, "TA": 2000}
        self.values |= {"PL": 31, "TL": 31, "PP": 0, "TP": 0, "PS": 1000, "TS": 1000}
        self.limits = {"PN": -3090, "PX": 3090, "TN": -907, "TX": 604}
        self.homed = homed
        self.odd: dict[str, bytes | None] = {}

    def __call__(self, command: str) -> bytes | None:
        if command in self.odd:
            return self.odd[command]
        if command == "R":
            self.homed = True
        name, digits = command[:2], command[2:]
        if name in self.values and digits:
            self.values[name] = int(digits)
        numbers = self.values | {
            limit: at if self.homed else 0 for limit, at in self.limits.items()
        }
        if command in numbers:
            return b"* %d\r\n" % numbers[command]
        return self.WORDS.get(command, b"*\r\n")


def client_for(answers: Answers) -> tuple[PtuClient, ScriptedHub, list[Exchange]]:
    hub = ScriptedHub(answers)
    seen: list[Exchange] = []
    client = PtuClient(
        Pump(hub), PTU_PORT, location="/dev/unit", baud=9600, on_exchange=seen.append
    )
    return client, hub, seen


def made_ready(client: PtuClient, settings: PtuSettings, *, homing: Homing = Homing.NEVER) -> Unit:
    driver = DirectedPerceptionUnit(client, PtuPort("x"))
    driver.identify()
    return open_unit(driver, settings, homing)


def test_a_unit_is_identified_before_any_command() -> None:
    client, hub, seen = client_for(ScriptedUnit())
    unit = made_ready(client, PtuSettings())
    assert hub.heard[:2] == ["V", "H"]
    assert unit.facts.dialect == "d46"
    assert unit.facts.metadata()["pan_max_steps"] == "3090"
    assert unit.facts.metadata()["tilt_resolution_arcsec"] == "185.142857"
    assert "counter_hz" not in unit.facts.metadata()
    assert not any(text.startswith(("PP", "TP", "R", "DS", "DF", "M")) for text in hub.heard)
    assert [exchange.command.text for exchange in seen] == hub.heard
    assert all(a.reply_ns <= b.request_ns for a, b in pairwise(seen))


def test_settings_are_set_and_read_back() -> None:
    unit = ScriptedUnit()
    client, hub, _ = client_for(unit)
    settings = PtuSettings(base_speed_deg_s=3.0, acceleration_deg_s2=200.0)
    facts = made_ready(client, settings).facts
    assert (facts.pan.base_speed, facts.tilt.acceleration) == (58, 3889)
    assert hub.heard.count("PB58") == 1


def test_an_unhomed_unit_needs_consent() -> None:
    client, hub, _ = client_for(ScriptedUnit(homed=False))
    with pytest.raises(UsageError, match="--home"):
        made_ready(client, PtuSettings())
    assert "R" not in hub.heard


@pytest.mark.parametrize(
    ("homed", "homing", "sweeps"),
    [(True, Homing.IF_NEEDED, 0), (True, Homing.ALWAYS, 1), (False, Homing.ALWAYS, 1)],
)
def test_a_homed_unit_can_be_homed_again(homed: bool, homing: Homing, sweeps: int) -> None:
    client, hub, _ = client_for(ScriptedUnit(homed=homed))
    made_ready(client, PtuSettings(), homing=homing)
    assert hub.heard.count("R") == sweeps


def test_limit_flags_during_homing_are_not_a_loss_of_synchrony() -> None:
    client, hub, _ = client_for(ScriptedUnit(homed=False))
    unit = made_ready(client, PtuSettings(), homing=Homing.IF_NEEDED)
    assert hub.heard.count("R") == 1
    assert unit.facts.pan.max_steps == 3090
    assert client.lost_synchrony is None
    assert client.counts.limit_flags == 4


def test_a_silent_port_is_reported() -> None:
    client, hub, _ = client_for(lambda _: None)
    with pytest.raises(DeviceError, match="no pan-tilt unit answers on /dev/unit at 9600"):
        made_ready(client, PtuSettings(), homing=Homing.IF_NEEDED)
    assert set(hub.heard) == {"V"}


@pytest.mark.parametrize("noise", [b"OK\r\n", b"* \r\n", b"\x00\x05\x80\x81\x00" * 20, b"ready\n"])
def test_another_device_is_not_moved(noise: bytes) -> None:
    client, hub, _ = client_for(lambda _: noise)
    with pytest.raises(DeviceError, match="is not a pan-tilt unit"):
        made_ready(client, PtuSettings(), homing=Homing.IF_NEEDED)
    assert set(hub.heard) == {"V"}


def test_a_refused_setting_is_reported_with_the_units_reply() -> None:
    unit = ScriptedUnit()
    unit.odd["PA3889"] = b"! Pan acceleration cannot exceed 3000 positions/sec^2\r\n"
    client, _, _ = client_for(unit)
    with pytest.raises(UsageError, match=r"pan acceleration 200 deg.*cannot exceed 3000"):
        made_ready(client, PtuSettings(acceleration_deg_s2=200.0))


def test_a_lost_digit_does_not_become_a_value() -> None:
    unit = ScriptedUnit()
    cut = {"PR": iter([b"* 18.142857\r\n"]), "TU": iter([b"* 290\r\n", b"* 2902\r\n", b"* 92\r\n"])}
    client, _, _ = client_for(lambda c: next(cut.get(c, iter(())), None) or unit(c))
    facts = made_ready(client, PtuSettings()).facts
    assert (facts.pan.resolution_arcsec, facts.tilt.upper_speed) == (185.142857, 2902)


def test_a_value_that_is_never_confirmed_is_an_error() -> None:
    unit, numbers = ScriptedUnit(), iter(range(100))
    client, _, _ = client_for(lambda c: b"* %d\r\n" % next(numbers) if c == "PX" else unit(c))
    with pytest.raises(DeviceError, match="different answer each time to the command 'PX'"):
        made_ready(client, PtuSettings())


def test_an_echoing_device_may_be_a_homing_unit() -> None:
    client, hub, _ = client_for(lambda c: c.encode() + b" ")
    with pytest.raises(DeviceError, match=r"only sends back .* wait until it stops"):
        made_ready(client, PtuSettings(), homing=Homing.IF_NEEDED)
    assert set(hub.heard) == {"V"}


def test_a_lost_reply_is_requested_again_after_a_timeout() -> None:
    unit = ScriptedUnit()
    lost = iter([None, b"* 5\r\n"])
    client, hub, seen = client_for(lambda c: next(lost) if c == "PP" else unit(c))
    reply = client.ask(query_quantity(Axis.PAN, Quantity.POSITION))
    assert reply.text == "5"
    assert client.counts.timeouts == 1
    assert [exchange.reply is None for exchange in seen] == [True, False, False]
    assert hub.heard == ["PP", "V", "PP"]


def test_three_missing_replies_are_an_error() -> None:
    client, _, _ = client_for(lambda _: None)
    with pytest.raises(DeviceError, match="does not answer the command 'PP'"):
        client.ask(query_quantity(Axis.PAN, Quantity.POSITION))


def test_an_invalid_reply_is_counted_and_requested_again() -> None:
    answers, unit = iter([b"\xff\xfe!!\r\n", b"* 7\r\n"]), ScriptedUnit()
    client, _, _ = client_for(lambda c: next(answers) if c == "PP" else unit(c))
    assert client.ask(query_quantity(Axis.PAN, Quantity.POSITION)).text == "7"
    assert client.counts.garbled == 1


def test_a_limit_flag_in_a_poll_is_lost_synchrony() -> None:
    unit = ScriptedUnit()
    client, _, _ = client_for(unit)
    ready_unit = made_ready(client, PtuSettings())
    poller = PositionPoller(ready_unit, None, lambda _: None)
    assert poller.read_positions() == {Axis.PAN: 0, Axis.TILT: 0}
    unit.odd["PP"] = b"!P* 100\r\n"
    unit.odd["TP"] = b"!P* 100\r\n"
    with pytest.raises(DeviceError, match="pan axis reached a limit"):
        poller.poll()


def test_a_d46_is_asked_ten_times_a_second_for_its_axes_in_turn() -> None:
    client, hub, seen = client_for(ScriptedUnit())
    unit = made_ready(client, PtuSettings())
    poller = PositionPoller(unit, None, lambda _: None)
    poller.read_positions()
    del hub.heard[:]
    begin_ns, known = hub.now_ns(), len(seen)
    while hub.now_ns() < begin_ns + 2000 * MS:
        poller.poll()
    assert 19 <= len(hub.heard) <= 21
    assert hub.heard[:4] in (["PP", "TP", "PP", "TP"], ["TP", "PP", "TP", "PP"])
    assert len(seen) == known  # polls are positions, not commands


def test_a_stop_is_noticed_between_chunks() -> None:
    hub, stop = ScriptedHub(lambda _: None), StopFlag()
    pump = Pump(hub, stop)
    client = PtuClient(pump, PTU_PORT, location="x", baud=9600, on_exchange=lambda _: None)
    stop.request("SIGTERM")
    with pytest.raises(StopRequestedError, match="SIGTERM"):
        client.exchange(QUERY_VERSION)
    pump.ignore_stop()
    assert client.exchange(HALT_BOTH_AXES).reply is None


def test_an_unplugged_port_is_reported() -> None:
    client, _, _ = client_for(lambda _: b"")
    with pytest.raises(DeviceError, match=r"/dev/unit .*unplugged"):
        client.ask(QUERY_VERSION)


PAN = query_quantity(Axis.PAN, Quantity.POSITION)


def test_a_late_reply_is_not_matched_with_the_next_command() -> None:
    unit = ScriptedUnit()
    client, hub, _ = client_for(unit)
    unit.values["PP"] = 5
    hub.delays_s["PP"] = [1.2]
    assert client.exchange(PAN).reply is None
    unit.values["PP"] = 7
    later = client.exchange(PAN)
    assert later.reply is not None
    assert later.reply.text == "7"
    assert client.counts.stale == 1


def test_a_superfluous_refusal_does_not_shift_the_replies() -> None:
    """Before, each later poll got the reply to the poll before it."""
    unit = ScriptedUnit()

    def answers(command: str) -> bytes | None:
        unit.values["PP"] += command == "PP"
        if command == "PP" and unit.values["PP"] == 5:
            refusal = b"! Illegal argument\r\n"
            hub._due.append(Chunk(PTU_PORT, hub.now_ns() + 2 * MS, refusal))
        return unit(command)

    client, hub, _ = client_for(answers)
    client.min_interval_s, hub.slow_s = 0.01, 0.035
    replies = []
    for _ in range(20):
        reply = client.exchange(PAN, is_poll=True).reply
        assert reply is not None
        replies.append((reply.text, str(unit.values["PP"])))
    assert [text for text, _ in replies if not text.isdigit()] == ["Illegal argument"]
    assert all(text == expected for text, expected in replies if text.isdigit())
    assert client.counts.stale == 1


def test_a_superfluous_reply_from_before_the_command_is_discarded() -> None:
    """It fits the command, but was received before the command was written."""
    unit = ScriptedUnit()
    client, hub, _ = client_for(unit)
    client.is_identified = True
    move = assign_quantity(Axis.PAN, Quantity.POSITION, 100)
    client.send_command(move)
    hub._due.append(Chunk(PTU_PORT, hub.now_ns() + MS, b"*\r\n"))
    hub._now_ns += 2 * MS  # the event loop reads the reply after it has written
    unit.odd["PP100"] = b"! Maximum allowable position is 90\r\n"
    with pytest.raises(DeviceError, match="Maximum"):
        client.send_command(move)
    assert client.counts.stale == 1
    assert hub.heard == ["PP100"] * 2  # no further exchange delays the command


@pytest.mark.parametrize("late_s", [1.05, 1.2, 2.5])
def test_a_late_reply_does_not_prevent_a_halt(late_s: float) -> None:
    unit = ScriptedUnit()
    client, hub, _ = client_for(unit)
    identify_unit(client)
    hub.delays_s["PP"] = [late_s]
    begin_ns = hub.now_ns()
    assert client.exchange(PAN).reply is None
    asked = len(hub.heard)
    client.halt()
    assert hub.heard[asked] == "H"  # before anything is waited for
    assert hub.now_ns() - begin_ns < 8_000 * MS


@pytest.mark.parametrize("slow_s", [0.5, 1.2, 1.9])
def test_a_unit_that_is_always_slow_is_halted_and_asked(slow_s: float) -> None:
    client, hub, _ = client_for(ScriptedUnit())
    identify_unit(client)
    hub.slow_s = slow_s
    client.halt()
    assert client.ask(PAN).text == "0"


def test_a_reply_that_does_not_fit_is_requested_again() -> None:
    unit = ScriptedUnit()
    odd = iter([b"* P(0,0) S(0,0) 1501459901\r\n"])
    client, hub, _ = client_for(lambda c: next(odd, None) or unit(c) if c == "H" else unit(c))
    client.halt()
    assert hub.heard == ["H", "H", "V", "H"]


def test_a_silent_unit_in_motion_is_noticed_within_seconds() -> None:
    unit = ScriptedUnit()
    client, hub, _ = client_for(unit)
    poller = PositionPoller(made_ready(client, PtuSettings()), None, lambda _: None)
    poller.read_positions()
    begin_ns = hub.now_ns()
    hub._answers = lambda _: None

    def poll_for_ever() -> None:
        while True:
            poller.poll()

    with pytest.raises(DeviceError, match="does not answer"):
        poll_for_ever()
    assert hub.now_ns() - begin_ns < 6_000 * MS
