"""YAML documents: bombs, tags, YAML 1.1, and that what is written is read back alike."""

import enum
import math
import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from gyrorig_protocol.documents import convert_document, dump_yaml, parse_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.schema_errors import find_schema_error

BOMB = "a0: &a0 [x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)
)

_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=60)
    | st.sampled_from(["yes", "no", "null", "~", "1", "010", "1:30", "1e5", ".nan", "2020-01-01"])
    | st.sampled_from(["<<", "=", "- a", "a: b", "#", "*a", "&a", "!t", "\t", "\x85", "\u2028"])
)
_KEYS = st.text(min_size=1, max_size=12) | st.sampled_from(["yes", "1", "null", "=", "<<", "1:30"])
VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_KEYS, inner, max_size=4),
    max_leaves=12,
)
DOCUMENTS = st.dictionaries(_KEYS, VALUES, max_size=5)


def outcome(call: Callable[[], object]) -> tuple[object, GyrorigError | None]:
    """Return the value or the named error, whose text is one line; any other error passes."""
    try:
        return call(), None
    except GyrorigError as error:
        fault = error
    assert "\n" not in str(fault)
    return None, fault


@given(document=DOCUMENTS)
@example(document={":": [None, None]})  # looks like a table
def test_dumped_documents_round_trip(document: dict[str, Any]) -> None:
    text = dump_yaml(document)
    assert parse_yaml(text, "it") == document
    assert parse_yaml(text.encode(), "it") == document
    assert yaml.safe_load(text) == document


@given(number=st.floats(allow_nan=False, allow_infinity=False))
def test_floats_are_dumped_as_yaml_1_2_reads_them(number: float) -> None:
    text = dump_yaml({"a": number}).removeprefix("a: ").strip()
    # YAML 1.2 core schema: [-+]? ( \. [0-9]+ | [0-9]+ ( \. [0-9]* )? ) ( [eE] [-+]? [0-9]+ )?
    mantissa, _, exponent = text.partition("e")
    assert "." in mantissa
    assert exponent == "" or exponent[0] in "+-"
    assert float(text) == number
    assert math.copysign(1, float(text)) == math.copysign(1, number)


class Colour(enum.IntEnum):
    RED = 3


def test_enumerations_and_numpy_floats_are_dumped_as_numbers() -> None:
    text = dump_yaml({"a": Colour.RED, "b": np.float64(1.5), "c": (True, None)})
    assert text == "a: 3\nb: 1.5\nc: [true, null]\n"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, b"x", {1, 2}, np.int64(3), 1j])
def test_unsupported_types_cannot_be_dumped(value: object) -> None:
    with pytest.raises(TypeError):
        dump_yaml({"a": [value]})


def test_a_repeated_value_is_written_twice() -> None:
    part = {"x": [1, 2]}
    assert "&" not in dump_yaml({"a": part, "b": part, "c": [part, part]})


@given(text=st.text(max_size=200) | st.binary(max_size=200))
def test_untrusted_text_gives_a_value_or_the_named_error(text: str | bytes) -> None:
    _, error = outcome(lambda: parse_yaml(text, "it", InputError))
    assert error is None or type(error) is InputError


_TAGS = ["!!int ", "!!float ", "!!bool ", "!!set ", "!!binary ", "!!omap ", "*a ", "&a ", "!x "]
_MARKS = ["a: ", "- ", "\n", "  ", "{", "}", "[", "]", ",", "? ", "<<: ", "---\n", "...\n", "|\n"]
_ODDITIES = [".inf", "1.0e+999", "0x", "''", "'", "1:30", "010", "2020-13-45", "=", "@", "`", "\t"]
_ODDITIES += [
    "2001-1-1T1:1:1-99:99",
    "%YAML 9.9\n",
    "\x00",
    "\ufeff",
    "\ud800",
    "1_000",
    "+.5",
    ".",
]
_FRAGMENTS = st.sampled_from(_TAGS + _MARKS + _ODDITIES)


@given(text=st.lists(_FRAGMENTS, max_size=25).map("".join))
def test_yaml_like_text_gives_a_value_or_the_named_error(text: str) -> None:
    value, _ = outcome(lambda: parse_yaml(text, "it"))
    _assert_plain(value)


def _assert_plain(value: object) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            _assert_plain(key)
            _assert_plain(item)
    elif isinstance(value, list):
        for item in value:
            _assert_plain(item)
    else:
        assert type(value) in (str, int, float, bool, type(None))
        assert not isinstance(value, float) or math.isfinite(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "alias"),
        ("a: *b", "alias"),
        ("[" * 21 + "]" * 21, "more than 20 levels"),
        ("[" * 100_000, "more than 20 levels"),
        ('{"a":' * 100_000, "more than 20 levels"),
        ("a: " + "x" * 4_000_000, "larger"),
        ("a: .nan", "finite"),
        ("a: -.INF", "finite"),
        ("a: 1.0e+999", "finite"),
        (".inf: 1", "finite"),
        ("a: !!float .nan", "tag"),
        ("a: !!int ''", "tag"),
        ("a: !!bool x", "tag"),
        ("!!python/object/apply:os.system [x]", "tag"),
        ("!x [1]", "tag"),
        ("a: 1\nb: 2\na: 3", "key a twice"),
        ("- {x: {y: 1, y: 1}}", "key y twice"),
        ("a: 010", "differently"),
        ("a: 1:30", "differently"),
        ("a: 1:30:15.5", "differently"),
        ("a: 1_000", "differently"),
        ("<<: {a: 1}", "differently"),
        ("a: 2020-01-01", "date"),
        ("a: 2001-12-14T21:59:43.10-05:00", "date"),
        ("a: 2020-13-45", "not a YAML document"),
        ("a: 0x" + "f" * 17, "68 bits"),
        ("a: " + "9" * 5000, "not a YAML document"),
        ("--- 1\n--- 2", "not a YAML document"),
        ("? [a]\n: b", "not a YAML document"),
        ("a: [", "not a YAML document"),
        ("\ud800", "not a YAML document"),
        ("a: \0", "not a YAML document"),
    ],
    ids=lambda value: str(value)[:24].encode("unicode_escape").decode(),
)
def test_unsupported_yaml_is_rejected(text: str, message: str) -> None:
    for kind in (UsageError, InputError):
        with pytest.raises(kind, match=message) as caught:
            parse_yaml(text, "rig.yaml", kind)
        assert type(caught.value) is kind
        assert str(caught.value).startswith("rig.yaml ")
        assert len(str(caught.value)) < 300


def test_20_levels_are_accepted() -> None:
    assert parse_yaml("[" * 20 + "]" * 20, "it") is not None


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("a: yes", {"a": True}),
        ("a: 'yes'", {"a": "yes"}),
        ("a: 1e5", {"a": "1e5"}),
        ("a: 0x10", {"a": 16}),
        ("a: 0", {"a": 0}),
        ("a: '010'", {"a": "010"}),
        ("a: 12:30 pm", {"a": "12:30 pm"}),
        ("{a: 1, 'a ': 2, A: 3}", {"a": 1, "a ": 2, "A": 3}),
    ],
)
def test_supported_yaml_is_accepted(text: str, value: object) -> None:
    assert parse_yaml(text, "it") == value


def test_base_60_takes_no_time_that_grows_with_the_square_of_its_length() -> None:
    # PyYAML alone: 1.8 s for 160 kB, four times as long for twice the length.
    begin = time.process_time()
    with pytest.raises(UsageError):
        parse_yaml("a: " + ":".join(["1"] * 1_000_000), "it")
    assert time.process_time() - begin < 2.0


class _Inner(msgspec.Struct, forbid_unknown_fields=True):
    port: str
    baud: int = 9600


class _Outer(msgspec.Struct, forbid_unknown_fields=True):
    ptu: _Inner
    speed: float | None = None


@pytest.mark.parametrize(
    ("value", "path"),
    [
        ({"ptu": {"port": 5}}, "it: ptu: port is 5. Give a text"),
        (
            {"ptu": {"port": "x", "bauds": 5}},
            "it: ptu has the unknown key 'bauds'. Did you mean baud\\? The valid keys are port, b",
        ),
        ({"ptu": {"port": "x", "baud": True}}, "it: ptu: baud is true. Give a whole number"),
        ({"ptu": {"port": "x", "baud": "9600"}}, "ptu: baud is the text '9600'. Give a whole"),
        ({"ptu": {"port": "x"}, "speed": "1e5"}, "speed is the text '1e5'. Give a number"),
        ({"ptu": {}}, "it: ptu lacks the key port. Add the key with a text"),
        ({"ptu": [1]}, "it: ptu is a list of 1. Give keys with values: port, baud"),
        ({"pt": {}}, "it has the unknown key 'pt'. Did you mean ptu"),
        ({1: 2}, "it has 1 as a key. The valid keys are ptu, speed"),
        (None, "it has no lines of the form `key: value`"),
        ([], "it has no lines of the form `key: value`"),
    ],
)
def test_wrong_values_are_rejected_with_their_location(value: object, path: str) -> None:
    with pytest.raises(InputError, match=path):
        convert_document(value, _Outer, "it", InputError)


class _Part(msgspec.Struct, forbid_unknown_fields=True):
    of: Literal["pan", "tilt"]
    deg: Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)] = 0.0
    many: Annotated[int, msgspec.Meta(gt=0)] = 1
    parts: "tuple[_Part, ...]" = ()


class _Whole(msgspec.Struct, forbid_unknown_fields=True):
    parts: Annotated[list[_Part], msgspec.Meta(min_length=1, max_length=3)]
    sizes: Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)] | None = None
    named: dict[str, _Part] = {}
    kind: Literal["whole/1"] = "whole/1"
    name: Annotated[str, msgspec.Meta(max_length=3, pattern="^[a-z]+$")] = "a"
    either: float | list[float | None] | None = None


_PAN = {"of": "pan"}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"parts": []}, "parts is a list of 0. Give a list of 1 to 3 entries, each keys with"),
        ({"parts": [_PAN, {"of": "roll"}]}, "parts, entry 2: of is the text 'roll'. Give one of p"),
        ({"parts": [{"of": "pan", "deg": 91}]}, "deg is 91. Give a number from -90 to 90"),
        ({"parts": [{"of": "pan", "many": 0}]}, "many is 0. Give a whole number above 0"),
        ({"parts": [{"of": "pan", "parts": [{}]}]}, "entry 1: parts, entry 1 lacks the key of"),
        ({"parts": [_PAN], "sizes": [1, 2]}, "sizes is a list of 2. Give a list of 3 entries"),
        ({"parts": [_PAN], "sizes": [1, None, 2]}, "sizes, entry 2 is empty. Give a number"),
        ({"parts": [_PAN], "named": {"a": _PAN, "b": 1}}, "named: b is 1. Give keys with values"),
        ({"parts": [_PAN], "kind": "whole/2"}, "kind is the text 'whole/2'. Give whole/1"),
        ({"parts": [_PAN], "name": "A"}, "'A'. Give a text of at most 3 characters of the form"),
        ({"parts": [_PAN], "either": "x"}, "either is the text 'x'. Give a number or a list, each"),
    ],
)
def test_the_error_gives_the_allowed_values(value: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        convert_document(value, _Whole, "it")


_LIKELY = st.sampled_from(
    ["parts", "of", "deg", "many", "sizes", "named", "kind", "name", "either"]
)
_LIKE_WHOLE = st.recursive(
    _SCALARS | st.sampled_from(["pan", "tilt", "whole/1", 1, 2.5, [1, 2.0, 3]]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_LIKELY, inner, max_size=5),
    max_leaves=12,
)


@given(value=st.dictionaries(_LIKELY, _LIKE_WHOLE, max_size=5) | DOCUMENTS)
def test_a_schema_error_is_found_exactly_if_msgspec_rejects(value: object) -> None:
    actual = find_schema_error(value, _Whole)
    try:
        msgspec.convert(value, type=_Whole, strict=True)
    except msgspec.ValidationError:
        assert actual is not None
        assert actual.remedy
    else:
        assert actual is None


def test_a_long_unknown_key_does_not_make_a_long_error() -> None:
    with pytest.raises(UsageError) as caught:
        convert_document({"ptu": {"port": "x"}, "k" * 100_000: 1}, _Outer, "it")
    assert len(str(caught.value)) < 300


@given(value=VALUES)
def test_reading_any_value_gives_the_structure_or_the_named_error(value: object) -> None:
    parsed, error = outcome(lambda: convert_document(value, _Outer, "it"))
    assert isinstance(parsed, _Outer) or type(error) is UsageError


@pytest.mark.parametrize(
    ("text", "place", "problem"),
    [
        ("a: [1", "line 2, column 1", "while parsing a flow sequence that begins in line 1"),
        ("a: 1\nb: c: d", "line 2, column 5", "mapping values are not allowed"),
    ],
)
def test_the_error_gives_the_position_of_a_syntax_error(
    text: str, place: str, problem: str
) -> None:
    _, fault = outcome(lambda: parse_yaml(text, "rig.yaml"))
    assert fault is not None
    assert f"rig.yaml is not a YAML document, {place}" in str(fault)
    assert problem in str(fault)
    assert "byte string" not in str(fault)
