"""The section `twin` of a rig file: what is read, what is rejected, and what is written."""

import copy
from typing import Any

import pytest

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.twin import find_quantity, parse_twin, twin_to_plain


def scalar(value: float, unit: str = "s") -> dict[str, Any]:
    """Return a plain number with its standard deviation."""
    return {"value": value, "std": 0.1 * abs(value), "unit": unit, "source": "recording"}


def section() -> dict[str, Any]:
    """Return a section with every key that a test changes."""
    unit_matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    return {
        "schema": "gyrorig/twin/1",
        "created": "2026-11-24T00:00:00Z",
        "software": "gyrorig 0.1.0",
        "recordings": [
            {
                "name": "a.mcap",
                "sha256": "0" * 64,
                "begin_s": 0.0,
                "end_s": 60.0,
                "first_move_s": 12.5,
            }
        ],
        "unit": {"answer_time": scalar(5e-3), "start_delay": scalar(2.5e-3)},
        "link": {"floor": scalar(6e-5), "jitter": scalar(3e-4)},
        "boards": {
            "B1": {
                "gain": {"value": unit_matrix, "std": None, "unit": "1"},
                "bias": {"value": [0.01, 0.0, -0.02], "std": [1e-5] * 3, "unit": "rad/s"},
                "time_offset": scalar(3e-3),
                "odr": scalar(101.2, "Hz"),
                "temperature": {"time_s": [0.0, 60.0], "degc": [25.0, 27.0]},
            }
        },
        "causes": [
            {
                "cause": "backlash",
                "where": "pan",
                "parameters": {"gap.pan": scalar(2e-4, "rad"), "begin.pan": scalar(1.0, "1")},
                "board": None,
            }
        ],
        "posterior": {
            "names": ["boards.B1.gain.0.2", "boards.B1.time_offset", "causes.0.gap.pan"],
            "covariance": [[1e-8, 0.0, 0.0], [0.0, 1e-8, 1e-9], [0.0, 1e-9, 4e-10]],
        },
    }


def rig_text(twin: object) -> str:
    """Return a rig file with a section."""
    return dump_yaml({"schema": "gyrorig/rig/1", "rig": "r", "twin": twin})


def test_a_section_is_read_and_written_again() -> None:
    twin = parse_twin(rig_text(section()), "twin.yaml")
    assert twin.boards["B1"].bias.value == (0.01, 0.0, -0.02)
    assert twin.causes[0].parameters["gap.pan"].value == 2e-4
    assert twin.boards["B1"].noise_density is None
    again = parse_twin(rig_text(twin_to_plain(twin)), "twin.yaml")
    assert again == twin


def test_names_of_the_posterior_mean_values() -> None:
    twin = parse_twin(rig_text(section()), "twin.yaml")
    bias_entry = find_quantity(twin, "boards.B1.gain.0.2")
    assert bias_entry == (twin.boards["B1"].gain, (0, 2))
    assert find_quantity(twin, "causes.0.gap.pan") == (twin.causes[0].parameters["gap.pan"], ())
    assert twin.unit is not None
    assert find_quantity(twin, "unit.answer_time") == (twin.unit.answer_time, ())
    for path in ("boards.B1.gain.0", "boards.B1.gain.0.3", "boards.B2.bias.0", "causes.1.gap.pan",
                 "boards.B1.clock.skew", "unit", "link.floor.0", "", "created"):  # fmt: skip
        assert find_quantity(twin, path) is None, path


def _changed(path: str, value: object) -> dict[str, Any]:
    changed: Any = copy.deepcopy(section())
    *words, last = path.split("/")
    owner = changed
    for word in words:
        owner = owner[int(word) if word.isdecimal() else word]
    owner[int(last) if last.isdecimal() else last] = value
    return changed  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("path", "value", "message_part"),
    [
        ("schema", "gyrorig/twin/2", "schema"),
        ("unknown", 1, "unknown"),
        ("boards", {}, "boards"),
        ("boards/B1/gain/value/0", [0.0, 0.0, 0.0], "singular"),
        ("boards/B1/bias/value", [0.0, 0.0], "bias"),
        ("boards/B1/bias/std", [-1.0, 0.0, 0.0], "std"),
        ("boards/B1/bias/unit", "deg/s", "must be 'rad/s'"),
        ("boards/B1/clock", {"skew": scalar(0.6, "1")}, "skew is 0.6"),
        ("boards/B1/clock", {"skew": scalar(7.0, "ppm")}, "must be '1'"),
        ("boards/B1/stamp_jitter", scalar(-1.0), "stamp_jitter is -1 s"),
        ("unit/answer_time/value", -1.0, "answer_time is -1 s"),
        ("unit/start_delay/value", 1e9, "start_delay is 1e+09 s"),
        ("unit/counter", {"skew": scalar(-1.0, "1")}, "skew is -1"),
        ("link/jitter/value", -1e-3, "jitter is -0.001 s"),
        ("link/floor/unit", "ms", "must be 's'"),
        ("link/stall_interval", scalar(-1.0), "stall_interval is negative"),
        ("link", {"stall_shortest": scalar(2.0), "stall_longest": scalar(1.0)}, "is longer than"),
        ("boards/B1/odr/value", 0.0, "odr is not positive"),
        ("boards/B1/odr/value", 1e9, "odr is 1e+09 Hz"),
        ("boards/B1/temperature/degc", [25.0, 26.0, 27.0], "2 times and 3 values"),
        ("boards/B1/temperature/time_s", [60.0, 60.0], "do not increase"),
        ("recordings/0/end_s", 0.0, "does not end"),
        ("recordings/0/sha256", "none", "sha256"),
        ("causes/0/board", "B2", "does not have"),
        ("causes/0/recording", "b.mcap", "not under `recordings`"),
        ("causes/0/cause", "../etc", "cause"),
        ("causes/0/parameters", {}, "parameters"),
        ("causes/0/parameters", {"gap.pan": scalar(60.0, "rad")}, "gap.pan is 60 rad, which no"),
        ("posterior/names/0", "boards.B1.gain", "no value of the twin has the name"),
        ("posterior/names/0", "boards.B1.time_offset", "twice"),
        ("posterior/covariance", [[1.0]], "3 rows and columns"),
        ("posterior/covariance/0/0", -1.0, "negative"),
        ("posterior/covariance/1/2", 2e-9, "not symmetric"),
        ("posterior/covariance/1", [0.0, 1e-20, 1e-9], "larger than"),
    ],
)
def test_what_is_not_valid_is_rejected_with_its_place(
    path: str, value: object, message_part: str
) -> None:
    with pytest.raises(UsageError) as raised:
        parse_twin(rig_text(_changed(path, value)), "twin.yaml")
    assert message_part in str(raised.value)
    assert str(raised.value).startswith("twin.yaml: twin")


def test_a_file_without_the_section_says_what_to_give() -> None:
    with pytest.raises(InputError, match="no key `twin`"):
        parse_twin(dump_yaml({"schema": "gyrorig/rig/1", "rig": "r"}), "rig.yaml", InputError)
    with pytest.raises(UsageError, match="not a finite number"):
        parse_twin(rig_text(section()).replace("12.5", ".inf"), "twin.yaml")
