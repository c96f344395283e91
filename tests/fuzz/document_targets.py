"""Documents that people and other programs write: YAML, names, a configuration in ruins."""

from functools import partial
from pathlib import Path
from typing import Any

from tests.fuzz.target import Target, check_single_line, expect_rejection, require

from gyrorig_daemon.commands.halt_command import _entries
from gyrorig_daemon.config import parse_rig
from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.profile import parse_profile
from gyrorig_protocol.program import parse_program
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.calibration.unit_document import (
    UnitIdentity,
    parse_unit,
    unit_as_yaml,
    unit_document,
)
from gyrorig_solver.uncertainty import UnitPosterior, default_settings

ROOT = Path(__file__).resolve().parents[2]
STATE = Path("/var/lib/gyrorig")


def documents(data: bytes) -> None:
    """A document is rejected with one line, or round-trips."""
    try:
        value = parse_yaml(data, "x")
    except UsageError as fault:
        check_single_line(fault)
        return
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        return
    try:
        text = dump_yaml(value)
    except TypeError:
        return  # a kind that no document of ours holds
    require(_with_text_keys(parse_yaml(text, "x")) == _with_text_keys(value), "it is changed")


def _with_text_keys(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _with_text_keys(item) for key, item in value.items()}
    return [_with_text_keys(item) for item in value] if isinstance(value, list) else value


def halt_config(data: bytes) -> None:
    """Of a configuration in ruins a halt takes a usable port and rate, or none."""
    entries = _entries(data, "x")
    port, baud = entries.port, entries.baud
    require(port is None or (port.isprintable() and 0 < len(port) <= 200), "no port at all")
    require(baud is None or 600 <= baud <= 2_000_000, "no rate at all")


def board_id(data: bytes) -> None:
    """A name is rejected, or stays in its folder."""
    try:
        name = BoardId(data.decode("utf-8", errors="surrogateescape"))
    except InputError as fault:
        check_single_line(fault)
        return
    require((STATE / name).resolve().parent == STATE.resolve(), "a name that leaves its folder")


def _files(pattern: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted(ROOT.glob(pattern))]


def _rig(data: bytes) -> None:
    expect_rejection(lambda text: parse_rig(text, "x"), UsageError, data)


def _program(data: bytes) -> None:
    expect_rejection(lambda text: parse_program(text, "x"), UsageError, data)


def _profile(data: bytes) -> None:
    expect_rejection(lambda text: parse_profile(text, "x"), UsageError, data)


def _calibration(data: bytes) -> None:
    expect_rejection(lambda text: parse_calibration(text, "x"), InputError, data)


def _unit_posterior(data: bytes) -> None:
    expect_rejection(lambda text: parse_unit(text, "x"), InputError, data)


def _unit_posterior_seeds() -> list[bytes]:
    identity = UnitIdentity("E46-0001", "serial")
    prior = UnitPosterior.from_table(default_settings())
    return [unit_as_yaml(unit_document(identity, prior, None, [], 0)).encode()]


TARGETS = (
    Target("documents", documents, partial(_files, "config/*.yaml"), 4096),
    Target("rig", _rig, partial(_files, "config/rig*.yaml"), 4096),
    Target("program", _program, partial(_files, "config/programs/*.yaml"), 4096),
    Target("profile", _profile, partial(_files, "config/boards/*.yaml"), 4096),
    Target("calibration", _calibration, partial(_files, "tests/unit/output/golden/*.yaml"), 16384),
    Target("unit_posterior", _unit_posterior, _unit_posterior_seeds, 16384),
    Target("halt_config", halt_config, partial(_files, "config/rig*.yaml"), 4096),
    Target("board_id", board_id, lambda: [b"GY80-1", b"../../etc/x", b"con"], 64),
)
