"""A calibration can have any text, and no text of it becomes code or a parameter in an export.

Each export of a hostile calibration is compared with that of a harmless one: without its comments
and the words in quotes, it must be the same, or the calibration is refused.
"""

import copy
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver import cli
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.export import FORMATS, ExportOptions, ExportSource, export_text

GOLDEN = yaml.safe_load(
    (Path(__file__).parents[1] / "output" / "golden" / "good.yaml").read_text(encoding="utf-8")
)
EXTRA = {"value": [1.0], "std": [0.0], "unit": "1"}
HOSTILE = (
    "*/ int main(void) { return 1; } /*",
    "\n*/\nint main(void) { return 1; }\n/*",
    " */ #error x /* ",
    "\\\n#error x",
    "??/\n#error x",
    "*\\ int main(void) { return 1; } /\\*",
    "*???/ /*/ **/ */*",
    '"; int x = system("id"); //',
    "x\n1\t1\tCAL_GYRO0_XOFF\t9\t9",
    "x\rINS_GYROFFS_X,9",
    "x\u2028INS_GYROFFS_X,9",
    "x\n  injected: 1\n",
    '"\ninjected: 1\n#',
    "x\x00y\x1b[2J\x85\x0b\x0c",
    "x" * 5000,
    "é */ \N{FULLWIDTH SOLIDUS}",
)
TEXT_PLACES: tuple[tuple[str, ...], ...] = (
    ("board", "id"),
    ("board", "sensor"),
    ("board", "uid"),
    ("created",),
    ("solver", "version"),
    ("solver", "method"),
    ("trust", "reasons"),
    ("model",),
    ("quality", "warnings"),
    ("units", "rate"),
    ("observability", "unobservable"),
)
NAME_PLACES = ("parameters", "noise")
PREFIXES = ("", "lost_steps@1.", "axis_tilt.")


def as_yaml(plain: object) -> str:
    return str(yaml.dump(plain, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)))


def with_text(place: tuple[str, ...], text: str) -> dict[str, Any]:
    plain: dict[str, Any] = copy.deepcopy(GOLDEN)
    plain["trust"] = {"verdict": "limited", "reasons": ["a reason"]}
    target: Any = plain
    for key in place[:-1]:
        target = target[key]
    is_list = isinstance(target.get(place[-1]), list)
    target[place[-1]] = [text] if is_list else text
    return plain


def with_name(place: str, name: str) -> dict[str, Any]:
    plain: dict[str, Any] = copy.deepcopy(GOLDEN)
    entry = EXTRA if place == "parameters" else {"value": [1e-3] * 3, "unit": "1"}
    plain[place] = {**plain[place], name: entry}
    return plain


def exports(plain: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Every export of a document; nothing if it is refused."""
    try:
        source = ExportSource.of(parse_calibration(as_yaml(plain), "v0001.yaml"))
    except InputError:
        return
    for kind in FORMATS:
        try:
            yield (
                kind,
                export_text(source, kind, ExportOptions(name="board" * (kind == "c") or None)),
            )
        except (InputError, UsageError):
            continue


def code_of(kind: str, text: str) -> Any:
    """What a compiler or loader takes from an export, without comments and quoted words."""
    assert all(c in "\n\t" or " " <= c <= "~" for c in text) or kind == "json"
    match kind:
        case "c":
            bare = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)
            return re.sub(r'"[^"\n\\]*"', '""', bare).split()
        case "ros" | "kalibr":
            return shape_of(yaml.safe_load(text))
        case "json":
            loaded = json.loads(text)
            del loaded["calibration"]
            return shape_of(loaded | {"not_applied": None})
        case _:
            return [line for line in text.splitlines() if not line.startswith("#")]


def shape_of(value: Any) -> Any:
    """A value with "" for each text."""
    if isinstance(value, dict):
        return {key: shape_of(item) for key, item in value.items()}
    if isinstance(value, list):
        return [shape_of(item) for item in value]
    return "" if isinstance(value, str) else value


HARMLESS = {kind: code_of(kind, text) for kind, text in exports(GOLDEN)}


def check(plain: dict[str, Any]) -> None:
    for kind, text in exports(plain):
        assert code_of(kind, text) == HARMLESS[kind], kind


def test_the_harmless_calibration_has_every_format() -> None:
    assert sorted(HARMLESS) == sorted(FORMATS)


@pytest.mark.parametrize("place", TEXT_PLACES, ids=".".join)
def test_hostile_text_stays_in_comments(place: tuple[str, ...]) -> None:
    for text in HOSTILE:
        check(with_text(place, text))


@pytest.mark.parametrize("place", NAME_PLACES)
def test_hostile_names_are_refused(place: str) -> None:
    for prefix in PREFIXES:
        for text in HOSTILE:
            for name in (prefix + text, prefix + text + " "):
                with pytest.raises(InputError, match="not the name of a parameter"):
                    parse_calibration(as_yaml(with_name(place, name)), "v0001.yaml")


@given(
    place=st.sampled_from(TEXT_PLACES),
    text=st.one_of(
        st.text(max_size=60),
        st.lists(st.sampled_from([*"*/\\\"'#?%{}\n\r\t:;,&!| ", "x", "é"]), max_size=40).map(
            "".join
        ),
    ),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(place=("board", "sensor"), text="*\\\n/")
def test_any_text_stays_in_comments(place: tuple[str, ...], text: str) -> None:
    check(with_text(place, text))


@given(
    place=st.sampled_from(NAME_PLACES),
    name=st.one_of(
        st.text(max_size=40),
        st.from_regex(r"(lost_steps|axis_tilt|wobble)(@\d)?(\.\w{1,5})?\s?", fullmatch=True),
    ),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_name_stays_a_name(place: str, name: str) -> None:
    if name not in GOLDEN[place]:
        check(with_name(place, name))


def test_the_compiler_accepts_every_hostile_header(tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("no gcc here: install gcc (apt install build-essential)")
    headers = {
        text
        for place in TEXT_PLACES
        for hostile in HOSTILE
        for kind, text in exports(with_text(place, hostile))
        if kind == "c"
    }
    assert len(headers) > 40
    files = [tmp_path / f"header{number}.h" for number in range(len(headers))]
    for file, text in zip(files, sorted(headers), strict=True):
        file.write_text(text)
    command = ["gcc", "-std=c99", "-trigraphs", "-Wall", "-Wextra", "-Werror"]
    command += ["-Wno-unused-function", "-fsyntax-only", "-x", "c", *map(str, files)]
    subprocess.run(command, check=True)  # each file alone
    main = tmp_path / "main.c"
    command = ["gcc", "-std=c99", "-trigraphs", "-Wall", "-Wextra", "-Werror"]
    command += ["-Wno-unused-function", "-fsyntax-only", "-x", "c", *map(str, files)]
    subprocess.run(command, check=True)  # each file alone
    main.write_text(f'#include "{files[0].name}"\nint main(void) {{ return 0; }}\n')
    subprocess.run(["gcc", "-fsyntax-only", str(main)], check=True)


ABSURD: tuple[tuple[tuple[str, ...], object], ...] = (
    (("board", "config", "gyro_scale_rad_s"), 1e-320),
    (("board", "config", "gyro_scale_rad_s"), -1.0),
    (("board", "config", "gyro_full_scale_dps"), 1e308),
    (("board", "config", "odr_hz"), 1e300),
    (("board", "config", "bandwidth_hz"), 0.0),
    (("parameters", "bias"), None),
    (("parameters", "bias", "value"), [1.0]),
    (("parameters", "bias", "value"), 1.0),
    (("parameters", "bias", "value"), [1e300, 0.0, 0.0]),
    (("parameters", "time_offset", "value"), [1.0]),
    (("matrices", "M"), [[1.0]]),
    (("matrices", "S"), []),
    (("matrices", "STM"), [[1e-200, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    (("matrices", "STM"), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    (("matrices", "S"), [[-0.98, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.03125]]),
    (("validity", "rate_rad_s"), [1.0, -1.0]),
    (("validity", "temperature_degc"), [-1e308, 1e308]),
    (("noise", "angle_random_walk", "value"), []),
    (("noise", "angle_random_walk", "value"), [1e300] * 3),
    (("version",), 2**63),
)


@pytest.mark.parametrize(("place", "value"), ABSURD, ids=lambda part: str(part)[:40])
@pytest.mark.parametrize("kind", FORMATS)
def test_absurd_values_are_refused(
    place: tuple[str, ...], value: object, kind: str, tmp_path: Path
) -> None:
    plain: dict[str, Any] = copy.deepcopy(GOLDEN)
    target = plain
    for key in place[:-1]:
        target = target[key]
    if value is None:
        del target[place[-1]]
    else:
        target[place[-1]] = value
    file = tmp_path / "v0001.yaml"
    file.write_text(as_yaml(plain))
    assert cli.run(["export", str(file), "--format", kind]) == 3


def test_consistent_but_tiny_gain_is_refused(tmp_path: Path) -> None:
    plain: dict[str, Any] = copy.deepcopy(GOLDEN)
    for name in ("S", "STM"):
        plain["matrices"][name] = [[1e-200 * v for v in row] for row in plain["matrices"][name]]
    file = tmp_path / "v0001.yaml"
    file.write_text(as_yaml(plain))
    assert cli.run(["export", str(file), "--format", "c"]) == 3


def test_one_reversed_axis_is_exported() -> None:
    plain: dict[str, Any] = copy.deepcopy(GOLDEN)
    for name in ("S", "STM"):
        plain["matrices"][name][0] = [-v for v in plain["matrices"][name][0]]
    assert "board_rate_float" in dict(exports(plain))["c"]


@pytest.mark.parametrize("kind", ["ros", "kalibr", "c"])
@pytest.mark.parametrize("name", ["/imu0\ninjected: 1", "a: b", "x #", "", "é", '"', "[a", "&a"])
def test_hostile_names_on_the_command_line_are_refused(
    kind: str, name: str, tmp_path: Path, run_export: Callable[..., int]
) -> None:
    assert run_export(kind, name) == 2


@pytest.fixture
def run_export(tmp_path: Path) -> Callable[..., int]:
    file = tmp_path / "v0001.yaml"
    file.write_text(as_yaml(GOLDEN))
    return lambda kind, name: cli.run(["export", str(file), "--format", kind, "--name", name])


@pytest.mark.parametrize("cause", ["scale_cubic", "thermal_bias.slope", "g_sensitivity"])
@pytest.mark.parametrize("kind", FORMATS)
def test_causes_with_another_number_of_values_are_refused(
    cause: str, kind: str, tmp_path: Path
) -> None:
    plain = with_name("parameters", cause)
    plain["parameters"]["thermal_bias.reference"] = {**EXTRA, "value": [25.0]}
    file = tmp_path / "v0001.yaml"
    file.write_text(as_yaml(plain))
    assert cli.run(["export", str(file), "--format", kind]) == 3
