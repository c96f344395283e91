"""Rig configurations: what is valid, and errors that name the place."""

import re
from pathlib import Path

import pytest

from gyrorig_daemon.config import load_rig, parse_rig
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import parse_program

ROOT = Path(__file__).resolve().parents[3]

GOOD = """
rig: desk
ptu: {port: emulated, baud: 115200}
boards:
  - {id: A-1, port: emulated}
"""
ONE = "- {id: A-1, port: emulated}"


def test_the_shipped_files_are_valid() -> None:
    assert load_rig(ROOT / "config" / "rig.yaml").is_emulated
    assert not load_rig(ROOT / "config" / "rig-raspberrypi.yaml").is_emulated
    for path in (ROOT / "config" / "programs").glob("*.yaml"):
        assert parse_program(path.read_bytes(), path.name).name == path.stem


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("rig*.yaml")), ids=lambda p: p.stem)
def test_shipped_programs_are_not_too_fast_for_a_shipped_rig(path: Path) -> None:
    limit_deg_s = load_rig(path).ptu.limits.speed_deg_s
    for program in (ROOT / "config" / "programs").glob("*.yaml"):
        asked_deg_s = map(float, re.findall(r"speed_deg_s: ([\d.]+)", program.read_text()))
        # A unit counts speeds in steps: at its limit it may be less by one.
        assert limit_deg_s is None or max(asked_deg_s) < limit_deg_s - 0.1, program.name


def test_defaults() -> None:
    rig = parse_rig(GOOD, "rig.yaml")
    assert rig.ports() == {"ptu": "emulated", "board:A-1": "emulated"}
    assert (rig.ptu.pan_sign, rig.ptu.dialect, rig.boards[0].format) == (1, "auto", "gcb1")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("baud: 115200", "bauds: 115200"), "bauds"),
        (("baud: 115200", "baud: '115200'"), "ptu: baud is the text '115200'"),
        (("baud: 115200", "baud: 115201"), "ptu: baud is 115201. Give one of 600, 1200,"),
        (("baud: 115200", "pan_sign: 0"), "pan_sign"),
        (("rig: desk", "rig: ../../etc"), "'../../etc' is not a valid name of a rig"),
        (("id: A-1", "id: ../x"), "board name"),
        (("rig: desk", "rig: desk\nschema: gyrorig/rig/2"), "schema"),
        (("port: emulated}", "port: emulated, format: text}"), "columns"),
        (("port: emulated}", "port: emulated, format: jsn}"), "Did you mean json?"),
        (("port: emulated}", "port: emulated, format: signals}"), "needs a CAN bus"),
        (("port: emulated}", "port: emulated, options: {a: 1}}"), "`options`"),
        (("port: emulated}", "port: x, format: json, options: {a: 1}}"), "gyro_key"),
        (("port: emulated}", "port: /dev/x, format: text}"), "columns"),
        (
            (
                "port: emulated}",
                "port: /dev/x, format: text, columns: {gyro: [0, 1, 2]}}",
            ),
            "facts",
        ),
        (("boards:", "boards: []\nboard:"), "board"),
        (("rig: desk", "rig: [desk"), "YAML"),
        (("baud: 115200", "limits: {pan_min_deg: 3.0, pan_max_deg: 1.0}"), "pan_min_deg"),
        ((ONE, "- {id: A, port: x}\n  - {id: A, port: y}"), "defines board A twice"),
        ((ONE, "- {id: A, port: x}\n  - {id: B, port: x}"), "uses the port x for two devices"),
    ],
)
def test_errors_name_the_key(change: tuple[str, str], word: str) -> None:
    text = GOOD.replace(*change)
    assert text != GOOD
    with pytest.raises(UsageError, match=r"rig\.yaml") as caught:
        parse_rig(text, "rig.yaml")
    assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.yaml"):
        load_rig(tmp_path / "none.yaml")


@pytest.mark.parametrize("port", ['"a\\0b"', '"a\\nb"', '""'])
def test_a_port_is_a_path(port: str) -> None:
    with pytest.raises(UsageError, match=r"ptu: port is the text"):
        parse_rig(GOOD.replace("port: emulated, baud", f"port: {port}, baud"), "rig.yaml")


def test_an_empty_document_is_called_empty(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(" \n")
    with pytest.raises(UsageError, match=r"rig\.yaml is empty"):
        load_rig(tmp_path / "rig.yaml")


@pytest.mark.parametrize(("odr_hz", "least"), [(100, 38400), (200, 115200), (800, 460800)])
def test_an_emulated_line_must_carry_its_samples(odr_hz: int, least: int) -> None:
    rig = "rig: x\nptu: {{port: emulated}}\nboards: [{{id: A, port: emulated, baud: {baud}}}]\n"
    rig += "emulator: {{odr_hz: {odr_hz}}}\n"
    with pytest.raises(UsageError, match=f"Set `baud` to {least} or more"):
        parse_rig(rig.format(baud=9600, odr_hz=odr_hz), "rig.yaml")
    assert parse_rig(rig.format(baud=least, odr_hz=odr_hz), "rig.yaml").boards[0].baud == least
