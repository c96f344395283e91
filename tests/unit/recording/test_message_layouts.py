"""The layouts of format 1 against rosbags' serializer, and the check of schemas in files."""

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gyrorig_protocol.recording.encoding.message_layouts import (
    FIXED_LAYOUTS,
    MAX_SCHEMA_BYTES,
    has_fields_of_format,
)
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW, SCHEMAS, SEPARATOR

IMU = "gyrorig_msgs/msg/ImuRaw"


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


def random_value(dtype: np.dtype[Any], random_source: random.Random) -> Any:
    """A number, or an array of numbers, that the field can hold."""
    if dtype.subdtype is not None:
        base, (length,) = dtype.subdtype
        return np.array([random_value(base, random_source) for _ in range(length)], base)
    if dtype.kind == "f":
        return random_source.randint(-1000, 1000) / 8
    bounds = np.iinfo(dtype)
    return random_source.randint(int(bounds.min), int(bounds.max))


@pytest.mark.parametrize("name", FIXED_LAYOUTS)
def test_layout_agrees_with_rosbags(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(SCHEMAS[name], name))
    layout = FIXED_LAYOUTS[name]
    time_class = store.types["builtin_interfaces/msg/Time"]
    for seed in range(20):
        source = random.Random(seed)
        values: list[Any] = []
        leaves: list[Any] = []
        for field in layout.dtype.names or ():
            dtype = layout.dtype[field]
            if dtype.names is not None:
                parts = [random_value(dtype[part], source) for part in dtype.names]
                values.append(time_class(*parts))
                leaves += parts
            else:
                values.append(random_value(dtype, source))
                leaves += np.atleast_1d(values[-1]).tolist()
        payload = bytes(store.serialize_cdr(store.types[name](*values), name))
        assert len(payload) == layout.size_bytes
        record = np.frombuffer(payload, layout.dtype, 1, 4)[0]
        assert list(leaves_of(record, layout.dtype)) == leaves


def test_messages_with_text_have_no_layout() -> None:
    assert set(SCHEMAS) - set(FIXED_LAYOUTS) == {
        name for name, text in SCHEMAS.items() if "string" in text
    }


def test_comments_constants_and_order_do_not_matter() -> None:
    main_record, dependency = IMU_RAW.split(SEPARATOR + "\n")
    other = (
        "# header\nuint8 X=1\n"
        + main_record.replace("int32[3] mag", "int32[3]  mag # raw")
        + f"{SEPARATOR}\nMSG: x/Other\nint8 a\n{SEPARATOR}\n"
        + dependency.replace("builtin_interfaces/Time", "builtin_interfaces/msg/Time")
    )
    assert has_fields_of_format(IMU, other.encode())


def test_a_struct_of_the_same_package_needs_no_package() -> None:
    name = "diagnostic_msgs/msg/DiagnosticArray"
    raw = SCHEMAS[name].replace("diagnostic_msgs/DiagnosticStatus[]", "DiagnosticStatus[]")
    raw = raw.replace("diagnostic_msgs/KeyValue[]", "KeyValue[]").replace(
        "std_msgs/Header header", "Header header"
    )
    assert raw != SCHEMAS[name]
    assert has_fields_of_format(name, raw.encode())


@pytest.mark.parametrize("name", SCHEMAS)
def test_another_field_matters(name: str) -> None:
    other = SCHEMAS[name].replace("uint32 nanosec", "int32 nanosec")
    assert not has_fields_of_format(name, other.encode())
    assert has_fields_of_format(name, SCHEMAS[name].encode())


@pytest.mark.parametrize(
    "schema",
    [
        b"",
        b"\xff\xfe",
        b"int8 a b c = ; d(",
        IMU_RAW.split(SEPARATOR)[0].encode(),  # without the struct of the times
        IMU_RAW.encode() + f"{SEPARATOR}\nno name here".encode(),
        IMU_RAW.replace("int32[3] mag\n", "int32[3] mag\nint32[3] more\n").encode(),
        IMU_RAW.replace("int32[3] mag", "int32[4000000000] mag").encode(),
        IMU_RAW.encode() + b"# " + b"x" * MAX_SCHEMA_BYTES,
    ],
)
def test_untrusted_schemas_are_rejected(schema: bytes) -> None:
    assert not has_fields_of_format(IMU, schema)
