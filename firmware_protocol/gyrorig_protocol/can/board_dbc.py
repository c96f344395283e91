"""The DBC text of our own boards' frames, for analysers, loggers and other people's tools.

A DBC message has one identifier, so there is a message per type and node. The text is also
shipped as a file, `config/can/gyrorig-boards.dbc`; a test keeps the two alike and reads them
with cantools.
"""

from collections.abc import Iterable

from gyrorig_protocol.can.board import SYNC_IDENTIFIER, FrameType, identifier

_TRIAD = [("X", 0, 16, "-"), ("Y", 16, 16, "-"), ("Z", 32, 16, "-")]
_LAYOUTS: dict[FrameType, tuple[int, list[tuple[str, int, int, str, str, str]]]] = {
    FrameType.LATCH: (
        8,
        [
            ("Counter", 0, 8, "+", "(1,0)", ""),
            ("Boot", 8, 8, "+", "(1,0)", ""),
            ("Clock", 16, 48, "+", "(1,0)", "us"),
        ],
    ),
    FrameType.ACCEL: (
        8,
        [
            *((f"Accel{axis}", at, size, sign, "(1,0)", "") for axis, at, size, sign in _TRIAD),
            ("Time", 48, 16, "+", "(4,0)", "us"),
        ],
    ),
    FrameType.GYRO: (
        8,
        [
            *((f"Gyro{axis}", at, size, sign, "(1,0)", "") for axis, at, size, sign in _TRIAD),
            ("Time", 48, 16, "+", "(4,0)", "us"),
        ],
    ),
    FrameType.STATUS: (
        8,
        [
            ("Time", 0, 32, "+", "(1,0)", "us"),
            ("Number", 32, 16, "+", "(1,0)", ""),
            ("Boot", 48, 16, "+", "(1,0)", ""),
        ],
    ),
    FrameType.HEALTH: (
        8,
        [
            ("Temperature", 0, 16, "-", "(1,0)", ""),
            ("AirTemperature", 16, 16, "-", "(0.1,0)", "degC"),
            ("Overruns", 32, 8, "+", "(1,0)", ""),
            ("FramesDropped", 40, 8, "+", "(1,0)", ""),
            ("BusErrors", 48, 8, "+", "(1,0)", ""),
            ("Saturations", 56, 8, "+", "(1,0)", ""),
        ],
    ),
    FrameType.HELLO: (
        8,
        [
            ("Segment", 0, 7, "+", "(1,0)", ""),
            ("Last", 7, 1, "+", "(1,0)", ""),
            ("Text", 8, 56, "+", "(1,0)", ""),
        ],
    ),
}


def board_dbc(nodes: Iterable[int]) -> str:
    """Return the DBC text for these nodes."""
    numbers = list(nodes)
    lines = ['VERSION "1"', "", "NS_ :", "", "BS_:", ""]
    lines.append("BU_: Host " + " ".join(f"Board{node}" for node in numbers))
    lines += ["", f"BO_ {SYNC_IDENTIFIER} Sync: 1 Host"]
    lines += _signals([("Counter", 0, 8, "+", "(1,0)", "")])
    for node in (0, *numbers):
        lines += ["", f"BO_ {identifier(FrameType.REQUEST, node)} Request{node}: 1 Host"]
        lines += _signals([("What", 0, 8, "+", "(1,0)", "")])
    for node in numbers:
        for kind, (length, layout) in _LAYOUTS.items():
            name = f"{kind.name.capitalize()}{node}"
            lines += ["", f"BO_ {identifier(kind, node)} {name}: {length} Board{node}"]
            lines += _signals(layout)
    return "\n".join(lines) + "\n"


def _signals(layout: list[tuple[str, int, int, str, str, str]]) -> list[str]:
    return [
        f' SG_ {name} : {start}|{size}@1{sign} {scale} [0|0] "{unit}" Vector__XXX'
        for name, start, size, sign, scale, unit in layout
    ]
