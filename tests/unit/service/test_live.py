"""The live view: the recording's bytes over a real WebSocket, thinned, and never in the way."""

import json
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from websocket import WebSocket, create_connection

from gyrorig_daemon.live import NO_VIEW
from gyrorig_daemon.live.foxglove_view import (
    STATUS_TOPIC,
    FoxgloveView,
    SampleThinning,
    open_live_view,
)
from gyrorig_daemon.service.status_screen import render_status
from gyrorig_protocol.errors import BusyError, UsageError
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS
from gyrorig_protocol.recording.messages import ImuRaw, Message, SessionEvent

TOPIC = "/board/B-1/imu_raw"
IMU = ImuRaw(5_000_000_000, 123, 7, 0, 21, (1, -2, 3), (4, 5, -6))
LATER = ImuRaw(6_000_000_000, 124, 8, 0, 21, (1, -2, 3), (4, 5, -6))


@pytest.fixture
def view() -> Iterator[FoxgloveView]:
    pytest.importorskip("foxglove", reason="no foxglove-sdk: it comes with the extra live")
    messages: list[str] = []
    foxglove = FoxgloveView("127.0.0.1", 0, messages.append)
    yield foxglove
    foxglove.close()
    assert not messages


class Viewer:
    """The other end: Foxglove's protocol, as far as a test needs it."""

    def __init__(self, port: int) -> None:
        self.socket: WebSocket = create_connection(
            f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], timeout=60.0
        )
        self.info: dict[str, Any] = json.loads(self.socket.recv())
        self.channels: dict[str, dict[str, Any]] = {}

    def subscribe(self, topic: str) -> None:
        while topic not in self.channels:
            document = json.loads(self.socket.recv())
            for channel in document.get("channels", []):
                self.channels[channel["topic"]] = channel
        wanted = {"id": 1, "channelId": self.channels[topic]["id"]}
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))

    def message(self) -> tuple[int, bytes]:
        """Log time and payload of the next message."""
        while True:
            data = self.socket.recv()
            if isinstance(data, bytes) and data[0] == 1:
                return struct.unpack_from("<Q", data, 5)[0], data[13:]

    def close(self) -> None:
        self.socket.close()


def until_watched(view: FoxgloveView, topic: str) -> None:
    """Wait until the subscription has arrived: it comes on a thread of the library's."""
    end_s = time.monotonic() + 60.0
    while not view._channels[topic].has_sinks():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def test_a_viewer_gets_the_recordings_own_bytes(view: FoxgloveView) -> None:
    view.show_message(TOPIC, IMU, IMU.host_time_ns)
    view.show_status({"state": "ready"})
    viewer = Viewer(view.port)
    assert viewer.info["capabilities"] == []  # nobody commands a rig this way
    viewer.subscribe(TOPIC)
    channel = viewer.channels[TOPIC]
    assert channel["encoding"] == "cdr"
    assert channel["schemaName"] == ImuRaw.TYPE
    assert channel["schema"] == SCHEMAS[ImuRaw.TYPE]
    until_watched(view, TOPIC)
    view.show_message(TOPIC, LATER, LATER.host_time_ns)
    assert viewer.message() == (6_000_000_000, LATER.encode())
    assert STATUS_TOPIC in view._channels
    viewer.close()


def test_a_fault_ends_the_view_and_nothing_else() -> None:
    pytest.importorskip("foxglove", reason="no foxglove-sdk: it comes with the extra live")
    messages: list[str] = []
    view = FoxgloveView("127.0.0.1", 0, messages.append)
    strange = SessionEvent(1, 0, "program", "x")
    view._channels["/x"] = object()  # has no has_sinks
    view.show_message("/x", strange, 1)
    view.show_message("/x", strange, 2)
    assert len(messages) == 1
    assert "the recording continues" in messages[0]


def test_an_address_that_is_taken(view: FoxgloveView) -> None:
    with pytest.raises(BusyError, match="Choose another"):
        open_live_view(f"127.0.0.1:{view.port}", print)


@pytest.mark.parametrize("address", ["8765", ":8765", "localhost:", "localhost:x", "h:70000"])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(UsageError, match="does not have the form HOST:PORT"):
        open_live_view(address, print)


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(UsageError, match=r"gyrorig\[live\]"):
        open_live_view("127.0.0.1:0", print)
    assert open_live_view(None, print) is NO_VIEW


@pytest.mark.parametrize(
    ("rate_hz", "least", "most"), [(50, 50, 50), (105, 95, 105), (800, 90, 110)]
)
def test_fast_boards_are_thinned(rate_hz: int, least: int, most: int) -> None:
    thinning = SampleThinning()
    shown = sum(thinning.is_due(TOPIC, 7 + round(k * 1e9 / rate_hz)) for k in range(10 * rate_hz))
    assert 10 * least <= shown <= 10 * most + 1


def test_a_clock_anchored_anew_goes_on() -> None:
    thinning = SampleThinning()
    assert thinning.is_due(TOPIC, 10**18)
    assert thinning.is_due(TOPIC, 10**18 - 5 * 10**9)


class CountingView:
    """A view that counts."""

    def __init__(self) -> None:
        self.topics: Counter[str] = Counter()

    def show_message(self, topic: str, message: Message, log_ns: int) -> None:
        self.topics[topic] += 1

    def show_status(self, document: dict[str, Any]) -> None:
        self.topics[STATUS_TOPIC] += 1

    def close(self) -> None:
        pass


def seen_by_a_view(bench: Any, seconds: float) -> Counter[str]:
    seen = CountingView()
    bench.parts.view = bench.opened.view = seen
    bench.serve(seconds)
    return seen.topics


def test_between_sessions_samples_are_seen(make_bench: Callable[..., Any]) -> None:
    topics = seen_by_a_view(make_bench(), 3.0)
    assert topics[TOPIC] > 100
    assert "/ptu/position" not in topics


def test_in_a_session_everything_recorded_is_seen(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
    bench.put()
    topics = seen_by_a_view(bench, 12.0)
    assert topics[TOPIC] > 500
    assert topics["/ptu/position"] > 20
    assert {"/ptu/command", "/session/event", "/diagnostics", "/host/clock"} <= set(topics)


def test_the_status_tells_place_time_left_and_latency(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
    bench.put()
    bench.serve(12.0)
    running = bench.state_at(5.0)
    assert running["session"]["elapsed_s"] > 0.0
    assert running["session"]["left_s"] >= 0.0
    assert running["unit"]["pan_deg"] is not None
    assert 0.0 <= running["boards"][0]["latency_ms"] <= running["boards"][0]["latency_max_ms"] + 1.0
    left_s = [
        status["session"]["left_s"]
        for status in bench.statuses
        if status["session"] and "left_s" in status["session"]
    ]
    assert left_s == sorted(left_s, reverse=True)
    assert bench.state_at(11.0)["session"] is None


AWAY = """
name: away
steps:
  - move: {pan_deg: 20.0, tilt_deg: -5.0, speed_deg_s: 40.0}
"""


def test_between_sessions_the_status_tells_where_the_unit_stands(
    make_bench: Callable[..., Any],
) -> None:
    bench = make_bench()
    bench.at(6.0, lambda: bench.put(AWAY))
    bench.serve(30.0)
    # what a step is worth the unit says in a session: before the first nothing is guessed
    assert bench.state_at(5.0)["unit"]["pan_deg"] is None
    assert len(bench.results("done")) == 1
    after = bench.state_at(29.0)
    assert after["session"] is None
    assert after["unit"]["pan_deg"] == pytest.approx(20.0, abs=0.06)  # a step is 185 arc seconds
    assert after["unit"]["tilt_deg"] == pytest.approx(-5.0, abs=0.06)
    assert ", pan +" in render_status(after)


def test_how_long_polls_take_is_told_apart_from_motions(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
    bench.put(home=True)
    bench.serve(60.0)
    unit = bench.state_at(59.0)["unit"]
    assert unit["reply_wait_max_ms"] > 1000.0  # a homing answers when both axes have been swept
    assert 0.0 < unit["poll_wait_max_ms"] < 200.0
