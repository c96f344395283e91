"""Messages survive encoding, and hostile payloads raise one error only."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.clock_messages import ClockPing, HostClock
from gyrorig_protocol.recording.encoding.message_layouts import FIXED_LAYOUTS
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS, SEPARATOR
from gyrorig_protocol.recording.messages import (
    ImuRaw,
    Message,
    PtuCommandRecord,
    PtuPosition,
    ReferenceAttitude,
    SessionEvent,
)
from gyrorig_protocol.recording.motion_messages import MotionOrder
from gyrorig_protocol.recording.recording import MESSAGE_TYPES
from gyrorig_protocol.recording.standard_messages import Diagnostics, DiagnosticStatus, Log

Plain = Callable[[Any], Any]

times = st.integers(0, 2**31 * 10**9 - 1)
u8, u16, u32, u64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64))
i16, i32 = (st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (16, 32))
floats = st.floats(allow_nan=False)
# A NUL is escaped on writing, and a lone surrogate is not text.
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
triples = st.tuples(i32, i32, i32)

MESSAGES: dict[type[Any], st.SearchStrategy[Any]] = {
    ImuRaw: st.builds(ImuRaw, times, u64, u32, u16, i16, triples, triples, triples),
    PtuPosition: st.builds(
        PtuPosition, times, times, times, i32, i32, floats, floats, u64, u32, u16
    ),
    PtuCommandRecord: st.builds(PtuCommandRecord, times, times, times, u32, u8, texts, texts),
    MotionOrder: st.builds(
        MotionOrder, times, times, times, floats, floats, floats, u32, u16, u8, u8, u8
    ),
    SessionEvent: st.builds(SessionEvent, times, u8, texts, texts),
    ClockPing: st.builds(ClockPing, times, times, u64, u64, u32, u16),
    HostClock: st.builds(HostClock, times, times, times, floats, floats, u32),
    ReferenceAttitude: st.builds(
        ReferenceAttitude, times, st.tuples(floats, floats, floats, floats), floats, u16
    ),
    Diagnostics: st.builds(
        Diagnostics,
        times,
        st.lists(
            st.builds(
                DiagnosticStatus, u8, texts, texts, texts, st.dictionaries(texts, texts, max_size=3)
            ),
            max_size=3,
        ).map(tuple),
        texts,
    ),
    Log: st.builds(Log, times, u8, texts, texts, texts, texts, u32),
}
any_message = st.one_of(*MESSAGES.values())


def test_every_schema_has_a_message_and_a_strategy() -> None:
    assert set(MESSAGE_TYPES) == set(SCHEMAS)
    assert set(MESSAGES) == set(MESSAGE_TYPES.values())


@given(message=any_message)
def test_round_trip(message: Message) -> None:
    assert MESSAGE_TYPES[message.TYPE].decode(message.encode()) == message


@given(message=any_message)
def test_fixed_sizes_are_those_of_the_schema(message: Message) -> None:
    layout = FIXED_LAYOUTS.get(message.TYPE)
    if layout is not None:
        assert len(message.encode()) == layout.size_bytes


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
@given(data=st.data())
def test_any_bytes_decode_or_raise_input_error(kind: type[Any], data: st.DataObject) -> None:
    complete = data.draw(MESSAGES[kind]).encode()
    index = data.draw(st.integers(0, len(complete) - 1))
    damaged = data.draw(
        st.sampled_from(
            [
                complete[:index],
                complete + b"x",
                complete[:index] + bytes([complete[index] ^ 0x55]) + complete[index + 1 :],
            ]
        )
        | st.binary(max_size=80)
    )
    with suppress(InputError):
        kind.decode(damaged)


@given(message=any_message)
def test_the_stock_decoder_reads_the_same(plain: Plain, message: Message) -> None:
    # mcap-ros2-support: another implementation of CDR, from the same schema text.
    name = message.TYPE
    decode = generate_dynamic(name, SCHEMAS[name])[name]
    assert plain(decode(message.encode())) == expected(message)


def test_rosbags_reads_the_same(plain: Plain) -> None:
    # rosbags: a third implementation; one message of each type is enough in addition.
    store = get_typestore(Stores.EMPTY)
    types: dict[str, Any] = {}
    for name, text in SCHEMAS.items():
        main_record, *dependencies = text.split(SEPARATOR + "\n")
        types |= get_types_from_msg(main_record, name)
        for part in dependencies:
            head, _, body = part.partition("\n")
            types |= get_types_from_msg(body, head.removeprefix("MSG: ").replace("/", "/msg/"))
    store.register(types)
    t = 1_790_000_000_123_456_789
    for message in (
        ImuRaw(t, 2**63, 2**31, 0x701, -5, (1, -2, 3), (4, -5, 6), (-7, 8, -9)),
        PtuCommandRecord(t, t + 1, t + 2, 3, 1, "PP ", "! é"),
        MotionOrder(t, t + 1, t + 2, 0.1, 111.0, 1000.0, 3, 7, 1, 0, 1),
        Diagnostics(t, (DiagnosticStatus(1, "a", "b", "c", {"k": "v"}),), "f"),
        Log(t, 20, "n", "m", "f", "g", 7),
    ):
        actual = store.deserialize_cdr(message.encode(), message.TYPE)
        assert plain(actual) == expected(message)


def expected(message: Any) -> dict[str, Any]:
    """The same from one of ours: field names without units, as the schema has them."""
    if isinstance(message, Diagnostics):
        status = [
            {
                "level": item.level,
                "name": item.name,
                "message": item.message,
                "hardware_id": item.hardware_id,
                "values": [{"key": k, "value": v} for k, v in item.values.items()],
            }
            for item in message.status
        ]
        return {
            "header": {"stamp": message.stamp_ns, "frame_id": message.frame_id},
            "status": status,
        }
    actual = {}
    for name in type(message).__slots__:
        value = getattr(message, name)
        for unit in ("_ns", "_rad", "_s"):
            name = name.removesuffix(unit)  # noqa: PLW2901
        actual[name] = list(value) if isinstance(value, tuple) else value
    return actual


@pytest.mark.parametrize(
    "message",
    [
        ImuRaw(-1 << 70, 0, 0, 0, 0, (0, 0, 0)),
        ImuRaw(0, 0, 0, 1 << 16, 0, (0, 0, 0)),
        ImuRaw(0, 0, 0, 0, 0, (1 << 31, 0, 0)),
        PtuCommandRecord(0, 0, 0, 0, 256, "", ""),
    ],
)
def test_values_out_of_range_are_rejected(message: Message) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        message.encode()


def test_a_nul_from_a_device_is_escaped() -> None:
    record = PtuCommandRecord(0, 0, 0, 0, 0, "PP ", "*\0 1")
    assert PtuCommandRecord.decode(record.encode()).reply == "*\\x00 1"
