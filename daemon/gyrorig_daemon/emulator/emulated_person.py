"""A person who follows the spoken lines of a manual session, as a device on the unit's port."""

import re

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.emulator_settings import HandSettings
from gyrorig_daemon.emulator.physics.hand_stage import HandMove, HandStage

FloatArray = NDArray[np.float64]

_POSE = re.compile(r"Place the board with its (.+) axis up\.")
_TURN = re.compile(r"Turn the board by (\S+) deg about (.+) within (\S+) s\.")
_REST = re.compile(r"Keep the board still for (\S+) s\.")
POSE_DURATION_S = 1.5
REACTION_S = (0.4, 0.7)
PACE = (0.45, 0.6)  # duration of a turn, as a share of the permitted time
MAX_BYTES = 4096


class EmulatedPerson:
    """Reads lines and moves the board; see `emulated_rig.EmulatedDevice`."""

    def __init__(
        self, settings: HandSettings, stage: HandStage, origin_ns: int, rng: np.random.Generator
    ) -> None:
        self._settings, self._stage, self._origin_ns, self._rng = settings, stage, origin_ns, rng
        self._buffer = b""
        self._turn: tuple[float, FloatArray, float] | None = None  # angle, axis, seconds
        self._turn_count = self._rest_count = 0

    def receive(self, data: bytes, at_ns: int) -> None:
        """Hear bytes that arrive at a time."""
        *lines, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[-MAX_BYTES:]
        for line in lines:
            self._follow(line.decode("utf-8", "replace").strip(), (at_ns - self._origin_ns) * 1e-9)

    def next_output_ns(self) -> int | None:
        """Return None: a person sends nothing."""
        return None

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return nothing."""
        del until_ns
        return []

    def _follow(self, line: str, now_s: float) -> None:
        start_s = now_s + self._rng.uniform(*REACTION_S)
        if match := _POSE.fullmatch(line):
            self._place(start_s, read_axis(match[1]))
        elif match := _TURN.fullmatch(line):
            self._turn_count += 1
            self._turn = (np.radians(float(match[1])), read_axis(match[2]), float(match[3]))
            if self._turn_count in self._settings.early_turns:
                self._start_turn(now_s + 2.0)
        elif line == "go" and self._turn_count not in self._settings.early_turns:
            self._start_turn(start_s)
        elif match := _REST.fullmatch(line):
            self._rest_count += 1
            if self._rest_count in self._settings.moved_rests:
                axis = np.array([0.0, 0.6, 0.8])
                self._move(start_s + 0.5 * float(match[1]), 1.0, axis, np.radians(20.0))

    def _place(self, start_s: float, up: FloatArray) -> None:
        """Turn the board about a horizontal axis until another one of its axes is up."""
        before = self._stage.up_at(np.array([start_s]))[0]
        angle = float(np.arccos(np.clip(before @ up, -1.0, 1.0)))
        axis = np.cross(up, before)
        if np.linalg.norm(axis) < 1e-9:  # upside down, or as before
            axis = np.cross(up, np.roll(up, 1))
        self._move(start_s, POSE_DURATION_S, axis / np.linalg.norm(axis), angle)

    def _start_turn(self, start_s: float) -> None:
        if self._turn is None:
            return
        angle_rad, axis, seconds = self._turn
        settings, number = self._settings, self._turn_count
        tilt = self._rng.normal(size=3) * np.radians(settings.axis_std_deg)
        turned_axis = axis + np.cross(tilt, axis)
        if number in settings.wrong_axes:
            turned_axis = np.roll(axis, 1)
        angle_rad += self._rng.normal() * np.radians(settings.angle_std_deg)
        if number in settings.short_turns:
            angle_rad *= 0.5
        duration_s = seconds * self._rng.uniform(*PACE)
        if number in settings.late_turns:
            duration_s = 1.1 * seconds
        self._move(start_s, duration_s, turned_axis / np.linalg.norm(turned_axis), angle_rad)

    def _move(self, start_s: float, duration_s: float, axis: FloatArray, angle_rad: float) -> None:
        up = self._stage.up_at(np.array([start_s]))[0]
        tremor = np.radians(self._settings.tremor_deg) * self._rng.uniform(0.3, 1.0, 3)
        self._stage.moves.append(HandMove(start_s, duration_s, axis, angle_rad, tremor, up))


def read_axis(text: str) -> FloatArray:
    """Return the axis that a spoken line names: `+z`, or `[0.6, 0.8, 0]`."""
    if text[1:] in ("x", "y", "z"):
        axis = np.zeros(3)
        axis["xyz".index(text[1])] = -1.0 if text[0] == "-" else 1.0
        return axis
    return np.array([float(component) for component in text.strip("[]").split(",")])
