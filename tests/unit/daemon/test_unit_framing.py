"""Words and bytes of a unit: lines in any portions, damaged replies, units other than degrees."""

import pytest

from gyrorig_daemon.motion.framing import MAX_REPLY_BYTES, LineFraming, decode_replies
from gyrorig_daemon.motion.text_language import NUMBER, TextLanguage
from gyrorig_protocol.ptu import Axis

MILLIDEGREES = TextLanguage(
    name="millidegrees",
    axes={Axis.PAN: "A"},
    identity="x",
    target="{axis} {value}",
    speed="{axis} V{value}",
    halt="S",
    position="{axis}?",
    positions=rf"(?P<value>{NUMBER})",
    accepted="ok",
    resolution_deg=0.002,
    unit_deg=0.001,
)


def test_lines_in_any_portions_are_the_same_replies() -> None:
    data = b"\r\n one \r\n\r\ntwo\rthree\n"
    for size in range(1, len(data) + 1):
        framing, received, replies = LineFraming("\r"), bytearray(), []
        for start in range(0, len(data), size):
            received += data[start : start + size]
            replies += decode_replies(framing, received)[0]
        assert replies == ["one", "two", "three"]
        assert not received


def test_damaged_and_endless_replies_are_counted_and_removed() -> None:
    framing, received = LineFraming("\n"), bytearray(b"\xff\xfe\ngood\n")
    assert decode_replies(framing, received) == (["good"], 1)
    received += bytes(b"x" * (MAX_REPLY_BYTES + 1))
    assert decode_replies(framing, received) == ([], 1)
    assert not received


def test_a_framing_that_removes_nothing_does_not_hang() -> None:
    class Endless(LineFraming):
        def decode(self, received: bytearray) -> str | None:
            return "again"

    with pytest.raises(AssertionError, match="not removed"):
        decode_replies(Endless("\n"), bytearray(b"x"))


def test_values_in_millidegrees_become_steps_of_the_driver() -> None:
    language = MILLIDEGREES
    assert language.format(language.target, Axis.PAN, -12.344) == "A -12344"
    assert language.read_positions("-12344", Axis.PAN) == ({Axis.PAN: -6172}, None)
    assert language.read_value_deg("90000") == pytest.approx(90.0)
    assert language.halt_bytes == b"\nS\n"
