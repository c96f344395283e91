"""Untrusted input of a running daemon: requests, jobs, schedules."""

from tests.fuzz.target import Target, expect_rejection, require

from gyrorig_daemon.service.jobs import parse_job
from gyrorig_daemon.service.service_protocol import (
    HALT_COMMANDS,
    PRIVILEGED_COMMANDS,
    QUERY_COMMANDS,
    decode_request,
)
from gyrorig_protocol.errors import UsageError

PROGRAM = b"name: p\nsteps:\n  - rest: {seconds: 1.0}\n"


def request(data: bytes) -> None:
    """A line is a known command, or none."""
    actual = decode_request(data)
    require(
        actual is None or actual in QUERY_COMMANDS | HALT_COMMANDS | PRIVILEGED_COMMANDS,
        "an unknown command",
    )


def _job(data: bytes) -> None:
    expect_rejection(lambda text: parse_job(text, "x"), UsageError, data)


TARGETS = (
    Target(
        "request", request, lambda: [b'{"command": "status"}', b'{"command":"halt"}', b"[" * 99]
    ),
    Target(
        "job",
        _job,
        lambda: [
            PROGRAM,
            b'schema: gyrorig/job/1\nsession: s-1\nhome: true\nprogram: "name: p\\nsteps: []\\n"\n',
        ],
        4096,
    ),
)
