"""The DBC file of our own boards' frames, for bus analysers, loggers and other programs.

A DBC message has one identifier, therefore there is one message per type and node. The text is also
shipped as `config/can/gyrorig-boards.dbc`. A test compares the two and reads them with cantools.
"""

from collections.abc import Iterable

from gyrorig_protocol.can.board_can_frames import SYNC_IDENTIFIER, FrameType, frame_identifier

_AXIS_BITS = [("X", 0, 16, "-"), ("Y", 16, 16, "-"), ("Z", 32, 16, "-")]
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
            *((f"Accel{axis}", at, size, sign, "(1,0)", "") for axis, at, size, sign in _AXIS_BITS),
            ("Time", 48, 16, "+", "(4,0)", "us"),
        ],
    ),
    FrameType.GYRO: (
        8,
        [
            *((f"Gyro{axis}", at, size, sign, "(1,0)", "") for axis, at, size, sign in _AXIS_BITS),
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
    node_numbers = list(nodes)
    lines = ['VERSION "1"', "", "NS_ :", "", "BS_:", ""]
    lines.append("BU_: Host " + " ".join(f"Board{node}" for node in node_numbers))
    lines += ["", f"BO_ {SYNC_IDENTIFIER} Sync: 1 Host"]
    lines += _signal_lines([("Counter", 0, 8, "+", "(1,0)", "")])
    for node in (0, *node_numbers):
        lines += ["", f"BO_ {frame_identifier(FrameType.REQUEST, node)} Request{node}: 1 Host"]
        lines += _signal_lines([("What", 0, 8, "+", "(1,0)", "")])
    for node in node_numbers:
        for frame_type, (length, layout) in _LAYOUTS.items():
            message_name = f"{frame_type.name.capitalize()}{node}"
            lines += [
                "",
                f"BO_ {frame_identifier(frame_type, node)} {message_name}: {length} Board{node}",
            ]
            lines += _signal_lines(layout)
    return "\n".join(lines) + "\n"


def _signal_lines(layout: list[tuple[str, int, int, str, str, str]]) -> list[str]:
    return [
        f' SG_ {name} : {start}|{size}@1{sign} {scale} [0|0] "{unit}" Vector__XXX'
        for name, start, size, sign, scale, unit in layout
    ]
