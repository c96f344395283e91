"""Settings and true parameters of the rig that a twin describes.

The base parameters of a fit contain what the base model absorbs of each cause. The cause states
this part (`CarriedCause`), and it is taken out of the base parameters here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_daemon.emulator.emulator_settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import (
    CAUSES,
    InjectedCause,
    apply_causes,
    sample_injected_causes,
)
from gyrorig_daemon.emulator.physics.lowpass import butterworth_delay_s
from gyrorig_daemon.emulator.physics.stepper_axis import ARCSEC_RAD
from gyrorig_daemon.emulator.rig_truth import BoardTruth, RigTruth, sample_rig_truth
from gyrorig_daemon.emulator.stated_cause import (
    SENSOR_AXES,
    UNIT_AXES,
    CarriedCause,
    Quantity,
    StatedBoard,
    StatedCause,
)
from gyrorig_daemon.emulator.twin.twin_devices import (
    base_truth,
    board_settings,
    clock_truth,
    in_recording,
    latency_truth,
    link_delay_s,
    reference_rise_k,
    starting_earlier,
    unit_lag_s,
    unit_settings,
    with_delay,
    without_turn,
)
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_protocol.twin import Twin, TwinBoard, TwinCause, TwinRecording

# A replayed recording that the twin was not fitted to. No event of another recording happens in it,
# and the phase of what repeats is not known.
OTHER_RECORDING = ""


@dataclass(frozen=True, slots=True, eq=False)
class TwinRig:
    """What `EmulatedRig` needs, and what the emulator does not have of a twin."""

    settings: RigSettings
    plain: RigTruth  # without causes
    truth: RigTruth
    notes: tuple[str, ...]  # causes of the twin that the emulated rig does not have, with reasons


def make_twin_rig(twin: Twin, settings: RigSettings, recording: str | None = None) -> TwinRig:
    """Return the rig that a twin describes.

    Args:
        twin: the section of the rig file.
        settings: of the rest of the file. The begin of `session_s` is the time since power-up at
            which the first sample of the recording is, and its injections are added.
        recording: whose single events happen; None: those of the first one. `OTHER_RECORDING`: no
            events, and a random phase of what repeats.

    Raises:
        UsageError: the twin has no board of the rig, or a cause cannot be used.
    """
    played = next((r for r in twin.recordings if r.name == recording), twin.recordings[0])
    boards = {
        board.name: in_recording(_find_board(twin, board.name), played.name)
        for board in settings.boards
    }
    settings = replace(
        settings,
        ptu=None if settings.ptu is None else unit_settings(twin.unit, settings.ptu),
        boards=tuple(board_settings(boards[board.name], board) for board in settings.boards),
    )
    sampled = sample_rig_truth(replace(settings, injections=()))
    begin_s = settings.session_s[0]
    plain_boards = {
        board.name: base_truth(
            boards[board.name],
            board,
            sampled.boards[board.name],
            begin_s - played.begin_s,
        )
        for board in settings.boards
    }
    latency = latency_truth(twin.link)
    link_delays_s = {
        board.name: link_delay_s(board, plain_boards[board.name], latency)
        for board in settings.boards
    }
    phase_rng = None
    if recording == OTHER_RECORDING:
        phase_rng = np.random.default_rng((settings.seed, settings.session_seed or 0))
    places = _Places(settings, played, boards, plain_boards, link_delays_s, phase_rng)
    carried, notes = _carry_causes(twin.causes, places)
    delays_s = {
        name: sum(part.delay_s for cause, part in carried if cause.board == name) for name in boards
    }
    for _, part in carried:
        if part.stage_turn_rad.any():
            plain_boards = {
                name: without_turn(board, part.stage_turn_rad)
                for name, board in plain_boards.items()
            }
    lag_s = 0.0
    if settings.ptu is not None:
        lag_s = unit_lag_s(latency)
        if twin.unit is not None and twin.unit.start_delay is not None:
            start_delay_s = sum(part.start_delay_s for _, part in carried)
            settings = replace(settings, ptu=starting_earlier(settings.ptu, start_delay_s))
    unit_clock = None if twin.unit is None else twin.unit.counter
    plain = replace(
        sampled,
        controller_clock=clock_truth(unit_clock, sampled.controller_clock),
        latency=latency,
        boards={
            name: with_delay(
                board,
                boards[name].time_offset.value - delays_s[name] - link_delays_s[name] - lag_s,
            )
            for name, board in plain_boards.items()
        },
    )
    injected = (*(cause for cause, _ in carried), *sample_injected_causes(settings))
    hooks = apply_causes(injected, settings.seed, settings.session_seed)
    truth = replace(plain, injected=injected).with_hooks(hooks)
    return TwinRig(settings, plain, truth, tuple(notes))


def _find_board(twin: Twin, name: str) -> TwinBoard:
    if name not in twin.boards:
        hint = did_you_mean(name, twin.boards)
        raise UsageError(
            f"the twin in the rig file has no board {name}",
            hint or f"name the boards of the rig as those of the twin: {', '.join(twin.boards)}",
        )
    return twin.boards[name]


def _check_places(cause: TwinCause, places: Sequence[str]) -> None:
    """Refuse places that the devices of a cause do not have.

    Raises:
        UsageError: a place is neither an axis of the unit nor one or more of the sensor.
    """
    if CAUSES[cause.cause].is_on_board():
        wrong = [place for place in places if not set(place) <= set("".join(SENSOR_AXES))]
        known = ", ".join(SENSOR_AXES)
    else:
        wrong = [place for place in places if place not in UNIT_AXES]
        known = ", ".join(UNIT_AXES)
    if wrong:
        raise UsageError(
            f"the cause {cause.cause} of the twin has the place {wrong[0]!r:.40} under `where`",
            f"write {known} or all",
        )


def _injected(name: str, board: str | None, carried: CarriedCause) -> InjectedCause:
    kind = CAUSES[name]
    first = next(iter(carried.parameters.values()))
    size = float(np.abs(first.array).max())
    return InjectedCause(
        cause=name,
        part=kind.part,
        component=carried.component or ",".join(kind.components) or "all",
        board=board,
        size=Quantity(size, kind.unit),
        parameters=carried.parameters,
    )


def _carry_causes(
    causes: Sequence[TwinCause], places: "_Places"
) -> tuple[list[tuple[InjectedCause, CarriedCause]], list[str]]:
    """Return the causes that act in the session, and notes on those that the rig does not have."""
    carried: list[tuple[InjectedCause, CarriedCause]] = []
    notes: list[str] = []
    for cause in causes:
        if places.is_other_recording and cause.recording is not None:
            notes.append(f"{cause.cause} happened once, in {cause.recording}, and is not repeated")
            continue
        if cause.recording not in (None, places.recording.name):
            continue
        reason = places.reason_not_carried(cause)
        if reason is not None:
            notes.append(f"the emulated rig does not have the cause {cause.cause}, {reason}")
            continue
        board_id = places.board_of(cause)
        kind = CAUSES[cause.cause]
        for part in kind.from_findings(places.stated(cause, board_id)):
            carried.append((_injected(cause.cause, board_id, part), part))
    return carried, notes


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """The devices on which the causes of a twin act."""

    settings: RigSettings
    recording: TwinRecording
    twin_boards: Mapping[str, TwinBoard]
    truths: Mapping[str, BoardTruth]
    link_delays_s: Mapping[str, float]
    phase_rng: np.random.Generator | None  # of what repeats in another recording

    @property
    def is_other_recording(self) -> bool:
        """Whether the session replays a recording that the twin was not fitted to."""
        return self.phase_rng is not None

    def reason_not_carried(self, cause: TwinCause) -> str | None:
        """Return why the emulated rig cannot have a cause, None if it can."""
        kind = CAUSES.get(cause.cause)
        if kind is None or set(cause.parameters) == {"count"}:
            return "because it cannot emulate it"
        if kind.part == "ptu" and self.settings.ptu is None:
            return "because its unit is not emulated"
        if kind.is_on_board() and cause.board is not None and cause.board not in self.truths:
            return f"because the board {cause.board} is not emulated"
        return None

    def board_of(self, cause: TwinCause) -> str | None:
        """Return the board on which a cause acts, None for one of the unit.

        Raises:
            UsageError: it is not stated, and there are several.
        """
        if not CAUSES[cause.cause].is_on_board():
            return None
        if cause.board is None and len(self.truths) != 1:
            raise UsageError(
                f"the cause {cause.cause} of the twin has no board",
                "write the id of its board under `board`",
            )
        return cause.board or next(iter(self.truths))

    def stated(self, cause: TwinCause, board_id: str | None) -> StatedCause:
        """Return a cause with its times since power-up."""
        settings, recording = self.settings, self.recording
        places = () if cause.where == "all" else tuple(cause.where.replace(",", " ").split())
        _check_places(cause, places)
        # Findings give times of the motion, and a sample shows an earlier motion.
        lag_s = 0.0 if board_id is None else self._lag_s(board_id)
        zero_s = settings.session_s[0] - recording.begin_s + lag_s
        unit = settings.ptu or PtuSettings()
        step_rad = unit.resolution_arcsec * ARCSEC_RAD
        return StatedCause(
            name=cause.cause,
            places=places,
            values={name: scalar.value for name, scalar in cause.parameters.items()},
            zero_s=zero_s,
            begin_s=zero_s + recording.begin_s,
            end_s=zero_s + recording.end_s,
            step_rad={"pan": unit.pan_sign * step_rad, "tilt": unit.tilt_sign * step_rad},
            latitude_deg=settings.latitude_deg,
            heading_deg=settings.heading_deg,
            board=None if board_id is None else self._stated_board(board_id),
            period_share=0.0 if self.phase_rng is None else self.phase_rng.uniform(),
        )

    def _lag_s(self, board_id: str) -> float:
        """Return how long after the motion a board samples it, without its low-pass."""
        filter_s = butterworth_delay_s(self.truths[board_id].imu.bandwidth_hz)
        total_s = self.twin_boards[board_id].time_offset.value
        return max(total_s - filter_s - self.link_delays_s[board_id], 0.0)

    def _stated_board(self, board_id: str) -> StatedBoard:
        imu = self.truths[board_id].imu
        begin_s = self.settings.session_s[0]
        length_s = self.recording.end_s - self.recording.begin_s
        return StatedBoard(
            mounting=imu.mounting,
            full_scale_rad_s=imu.gyro_limit_rad_s,
            period_s=1.0 / imu.odr_hz,
            bandwidth_hz=imu.bandwidth_hz,
            reference_rise_k=reference_rise_k(
                self.twin_boards[board_id], imu, (begin_s, begin_s + length_s)
            ),
        )
