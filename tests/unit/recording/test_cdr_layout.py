"""The layout derived from a schema against rosbags' serializer, on random schemas."""

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.encoding.cdr_layout import derive_fixed_layout
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW, SCHEMAS, SEPARATOR
from gyrorig_protocol.recording.encoding.ros2msg import have_same_fields

NUMBERS = {
    "bool": (0, 1),
    "byte": (0, 127),  # rosbags packs it signed
    "uint8": (0, 255),
    "int8": (-128, 127),
    "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint32": (0, 2**32 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint64": (0, 2**64 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "float32": None,
    "float64": None,
}
NUMPY = {"bool": "?", "byte": "u1", "float32": "f4", "float64": "f8"}


class RandomSchema:
    """A random nest of structs, as text and as a table of fields."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.table: dict[str, list[tuple[str, int | None, str]]] = {}
        self.table["builtin_interfaces/Time"] = [
            ("int32", None, "sec"),
            ("uint32", None, "nanosec"),
        ]
        for depth in range(self.random.randint(0, 3)):
            self.table[f"p/S{depth}"] = self.fields()
        self.table["p/Top"] = self.fields()

    def fields(self) -> list[tuple[str, int | None, str]]:
        previous = list(self.table)
        actual = []
        for i in range(self.random.randint(1, 5)):
            kind = self.random.choice([*NUMBERS, *previous, *previous])
            length = self.random.choice([None, None, 1, 2, 3])
            actual.append((kind, length, f"f{i}"))
        return actual

    def lines(self, name: str) -> str:
        rows = [
            f"{kind}{'' if n is None else f'[{n}]'} {field}" for kind, n, field in self.table[name]
        ]
        return "\n".join(["# a comment", "uint8 LIMIT=3", *rows]) + "\n"

    def text(self) -> str:
        parts = [self.lines("p/Top")]
        parts += [f"MSG: {n}\n{self.lines(n)}" for n in self.table if n != "p/Top"]
        return (SEPARATOR + "\n").join(parts)

    def value(self, kind: str) -> Any:
        bounds = NUMBERS[kind]
        if bounds is None:
            return self.random.randint(-1000, 1000) / 8
        return bool(self.random.randint(0, 1)) if kind == "bool" else self.random.randint(*bounds)

    def message(self, store: Any, name: str, leaves: list[Any]) -> Any:
        """A message of rosbags' own class; its leaves are appended in order."""
        values = []
        for kind, length, _ in self.table[name]:
            if kind in NUMBERS:
                drawn = [self.value(kind) for _ in range(length or 1)]
                leaves += drawn
                item = np.array(drawn, NUMPY.get(kind, kind))
                values.append(drawn[0] if length is None else item)
            else:
                parts = [self.message(store, kind, leaves) for _ in range(length or 1)]
                values.append(parts[0] if length is None else parts)
        return store.types[name.replace("/", "/msg/")](*values)


def leaves_of(value: Any, dtype: np.dtype[Any]) -> Iterator[Any]:
    """The numbers of a structured value, in the order of the fields."""
    if dtype.names is not None:
        for name in dtype.names:
            yield from leaves_of(value[name], dtype[name])
    elif dtype.subdtype is not None:
        for item in value:
            yield from leaves_of(item, dtype.subdtype[0])
    else:
        yield value.item()


@pytest.mark.parametrize("block", range(6))
def test_layout_agrees_with_rosbags(block: int) -> None:
    for seed in range(block * 50, block * 50 + 50):
        schema = RandomSchema(seed)
        store = get_typestore(Stores.EMPTY)
        types: dict[str, Any] = {}
        for name in schema.table:
            types |= get_types_from_msg(schema.lines(name), name.replace("/", "/msg/"))
        store.register(types)
        leaves: list[Any] = []
        payload = bytes(store.serialize_cdr(schema.message(store, "p/Top", leaves), "p/msg/Top"))
        layout = derive_fixed_layout("p/msg/Top", schema.text())
        assert layout is not None
        assert layout.size_bytes == len(payload), schema.text()
        value = np.frombuffer(payload, layout.dtype, 1, 4)[0]
        assert list(leaves_of(value, layout.dtype)) == leaves, schema.text()


@pytest.mark.parametrize("kind", ["string a", "int32[] a", "int32[<=3] a", "string<=5 a", ""])
def test_messages_of_variable_size_have_no_layout(kind: str) -> None:
    assert derive_fixed_layout("p/msg/T", kind + "\n") is None


@pytest.mark.parametrize(
    "text",
    [
        "p/T inner",  # refers to itself
        "q/Unknown a",
        "int33 a",
        "uint8[4000000000] a",
        "uint8[0] a",
        "int8 a\nint8 a",
        "int8 a b c = ; d(",
        f"p/A[60000] a\n{SEPARATOR}\nMSG: p/A\np/B[60000] a\n{SEPARATOR}\nMSG: p/B\nint8 a",
        f"int8 a\n{SEPARATOR}\nno name here",
    ],
)
def test_untrusted_schemas_are_rejected(text: str) -> None:
    try:
        actual = derive_fixed_layout("p/msg/T", text)
    except InputError:
        return
    assert actual is not None
    assert actual.size_bytes < 1 << 17


def test_comments_constants_and_order_do_not_matter() -> None:
    main_record, dependency = IMU_RAW.split(SEPARATOR + "\n")
    other = (
        "# header\nuint8 X=1\n"
        + main_record.replace("int32[3] mag", "int32[3]  mag # raw")
        + f"{SEPARATOR}\n"
        + dependency.replace("builtin_interfaces/Time", "builtin_interfaces/msg/Time")
    )
    assert have_same_fields("gyrorig_msgs/msg/ImuRaw", IMU_RAW, other)


@pytest.mark.parametrize("name", SCHEMAS)
def test_another_field_matters(name: str) -> None:
    other = SCHEMAS[name].replace("uint32 nanosec", "int32 nanosec")
    assert not have_same_fields(name, SCHEMAS[name], other)
    assert have_same_fields(name, SCHEMAS[name], SCHEMAS[name])
