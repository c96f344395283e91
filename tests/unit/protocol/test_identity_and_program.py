"""Names that become paths, and motion programs that would never end."""

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, parse_program, unroll_steps
from gyrorig_protocol.program.program_document import MAX_STEPS


def outcome(call: Callable[[], object]) -> tuple[object, GyrorigError | None]:
    """Return the value or the named error, whose text is one line; any other error passes."""
    try:
        return call(), None
    except GyrorigError as error:
        fault = error
    assert "\n" not in str(fault)
    return None, fault


@pytest.mark.parametrize("name", ["a", "A1", "l3g-7", "0", "x" * 32])
def test_board_names(name: str) -> None:
    assert BoardId(name) == name
    assert isinstance(BoardId(name), str)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "-a",
        ".",
        "..",
        "a/b",
        "../x",
        "a b",
        "a\n",
        "a\0",
        "x" * 33,
        "ä",
        "\u0661",
        "a_b",
        "a.b",
    ],
)
def test_invalid_board_names_are_rejected(name: str) -> None:
    with pytest.raises(InputError, match="is not a valid board name"):
        BoardId(name)


@given(name=st.text(max_size=40))
def test_a_board_name_is_safe_in_a_path_or_rejected(name: str) -> None:
    board, error = outcome(lambda: BoardId(name))
    if error is not None:
        assert type(error) is InputError
        assert len(str(error)) < 600
    else:
        assert isinstance(board, BoardId)
        assert board.isascii()
        assert board.replace("-", "a").isalnum()
        assert 1 <= len(board) <= 32


def program(steps: str, head: str = "name: p\n") -> MotionProgram:
    return parse_program(f"{head}steps:\n{steps}", "p.yaml")


def test_repeats_are_expanded_in_order() -> None:
    parsed = program(
        "- {rest: {seconds: 1.0, phase: static}}\n"
        "- repeat:\n"
        "    times: 2\n"
        "    steps:\n"
        "    - {move: {pan_deg: 5.0}}\n"
        "    - {repeat: {times: 2, steps: [{rest: {seconds: 2}}]}}\n"
        "- {home: {}}\n"
    )
    move, rest = Move(pan_deg=5.0), Rest(seconds=2.0)
    expected = [Rest(1.0, "static"), move, rest, rest, move, rest, rest, Home()]
    assert list(unroll_steps(parsed.steps, "p")) == expected


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ("", "steps is empty. Give a list"),
        ("  []", "no steps"),
        ("- {}", "step 1 of the motion program p.yaml has no action"),
        ("- {rest: {seconds: 1}, home: {}}", "motion program p.yaml has rest and home"),
        ("- {home: {}}\n- {move: {}}", "step 2 of the motion program p.yaml has no target angle"),
        ("- {repeat: {times: 2, steps: [{home: {}}, {move: {speed_deg_s: 5}}]}}", "step 1.2 of"),
        ("- {move: {pan_deg: 5, speed: 5}}", "unknown key 'speed'. Did you mean speed_deg_s"),
        ("- {move: {pan_deg: 5, speed_deg_s: 0}}", "speed_deg_s"),
        ("- {move: {pan_deg: 5, speed_deg_s: -1}}", "speed_deg_s"),
        ("- {move: {pan_deg: .nan}}", "finite"),
        ("- {move: {pan_deg: 1.0e+999}}", "finite"),
        ("- {move: {pan_deg: 1:30}}", "differently"),
        ("- {move: {pan_deg: 1, pan_deg: 2}}", "twice"),
        ("- {rest: {seconds: 86401}}", "seconds"),
        ("- {rest: {seconds: -1}}", "seconds"),
        ("- {rest: {seconds: yes}}", "seconds"),
        ("- {rest: {seconds: 1, phase: sleep}}", "phase"),
        ("- {repeat: {times: 0, steps: [{home: {}}]}}", "times"),
        ("- {repeat: {times: 10001, steps: [{home: {}}]}}", "times"),
        ("- {repeat: {times: 1.5, steps: [{home: {}}]}}", "times"),
        ("- {repeat: {times: 2, steps: []}}", "steps"),
        ("- {jump: {}}", "unknown key 'jump'. The valid keys are rest, move, repeat, home"),
    ],
)
def test_invalid_programs_are_rejected(steps: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        program(steps)
    assert "p.yaml" in str(caught.value)


def test_too_many_repeats_are_rejected_without_expansion() -> None:
    steps = "{rest: {seconds: 1}}"
    for _ in range(4):
        steps = f"{{repeat: {{times: 10000, steps: [{steps}]}}}}"
    with pytest.raises(UsageError, match=f"more than {MAX_STEPS} steps"):
        program(f"- {steps}")


def test_the_largest_number_of_steps() -> None:
    repeat = "- {repeat: {times: 10000, steps: [%s]}}\n"
    ten = ", ".join(["{home: {}}"] * 10)
    assert program(repeat % ten).steps
    with pytest.raises(UsageError, match="steps"):
        program(repeat % ten + "- {home: {}}")


def test_schema_and_settings() -> None:
    head = "schema: gyrorig/program/1\nname: p\nsettings: {base_speed_deg_s: 3.0}\n"
    parsed = program("- {home: {}}", head)
    assert parsed.settings.base_speed_deg_s == 3.0
    for wrong in ("schema: gyrorig/program/2\nname: p\n", "name: 5\n", "nam: p\n"):
        with pytest.raises(UsageError):
            program("- {home: {}}", wrong)


@given(text=st.text(max_size=100))
def test_any_text_is_a_program_or_a_usage_error(text: str) -> None:
    _, error = outcome(lambda: parse_program(text, "p.yaml"))
    assert error is None or type(error) is UsageError


@given(
    seconds=st.floats(0, 86_400),
    pan_deg=st.floats(-180, 180),
    times=st.integers(1, 10_000),
    name=st.text(max_size=20),
)
@settings(deadline=None)  # ten thousand steps, on a machine that may have other work
def test_a_dumped_program_is_read_back(
    seconds: float, pan_deg: float, times: int, name: str
) -> None:
    document = {
        "schema": "gyrorig/program/1",
        "name": name,
        "steps": [
            {"rest": {"seconds": seconds, "phase": "static"}},
            {"repeat": {"times": times, "steps": [{"move": {"pan_deg": pan_deg}}]}},
        ],
    }
    parsed = parse_program(dump_yaml(document), "p.yaml")
    assert parsed.name == name
    parts = list(unroll_steps(parsed.steps, "p"))
    assert parts[0] == Rest(seconds, "static")
    assert parts[1:] == [Move(pan_deg=pan_deg)] * times
