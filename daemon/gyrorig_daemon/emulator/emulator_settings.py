"""Settings of an emulated rig: unit, boards, faults, injected causes, seed.

Everything that a test can vary is a field here. The true parameters, which are sampled from the
seed and hidden from clients, are in `rig_truth`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from gyrorig_protocol.board import ColumnMap
from gyrorig_protocol.can import SignalMap

Dialect = Literal["d46", "e46", "d48e"]  # d48e: a D48E, which has the dialect e46

StepMode = Literal["F", "H", "Q", "E", "A"]  # full, half, quarter, eighth, auto

# 17.5:1 gear, 200 full steps per turn: 360 deg / 3500. Half of it is the 185.1428 arc-seconds
# in the D46 user's manual v2.14.
FULL_STEP_ARCSEC = 1296000.0 / 3500.0
STEPS_PER_FULL_STEP = {"F": 1, "H": 2, "Q": 4, "E": 8, "A": 8}

# Low-pass choices of the L3G4200D by output data rate (RIOT-OS drivers/include/l3g4200d.h).
BANDWIDTHS_HZ = {
    100.0: (12.5, 25.0),
    200.0: (12.5, 25.0, 50.0, 70.0),
    400.0: (20.0, 25.0, 50.0, 110.0),
    800.0: (30.0, 35.0, 50.0, 110.0),
}


@dataclass(frozen=True, slots=True)
class PtuFaults:
    """Faults on the unit's line. Numbers count replies since power-up, from 1."""

    silent: bool = False  # never answers
    lose_byte_every: int = 0  # every n-th reply loses a byte; 0 = never
    garbage_every: int = 0  # random bytes before every n-th reply
    error_every: int = 0  # every n-th command is rejected as illegal and not executed
    lose_steps_at_s: float | None = None  # once, `lost_steps` of pan are lost without a message
    lost_steps: int = 0


@dataclass(frozen=True, slots=True)
class PtuSettings:
    """A motion unit, by default a PTU-E46 or D46, and its state when the port is opened."""

    driver: str = "directed_perception"  # whose unit it is
    dialect: Dialect = "e46"
    baud: int = 9600
    command_time_ms: float = 1.0  # 1, 10 or 20 (E-series), 100 (D-series by the vendor)
    sample_fraction: float = 0.5  # the count is read at this fraction of the command time
    start_delay_ms: float = 0.0  # from the time at which a count would be read to the motion
    echo: bool = True
    verbose: bool = True
    leading_lf_on_cr: bool = True  # with echo off a reply to CR starts with LF
    acceleration_text: Literal["sec^2", "sec/sec"] = "sec^2"
    banner: bool = False
    homed: bool = True
    sweep_at_power_up: bool = False  # homes at power-up, then sends its banner
    homing_speed_steps_s: float = 2000.0
    recompute_s: float = 3.0  # PA, PB, PU: the unit recomputes its tables
    unit_id: int = 0  # if not 0: silent until selected
    step_mode: StepMode = "H"  # at power-up; the steps below are in this mode
    full_step_arcsec: float = FULL_STEP_ARCSEC
    pan_sign: int = 1
    tilt_sign: int = 1
    pan_min_steps: int = -3090
    pan_max_steps: int = 3090
    tilt_min_steps: int = -907
    tilt_max_steps: int = 604
    base_speed_steps_s: int = 1000
    speed_steps_s: int = 1000
    acceleration_steps_s2: int = 2000
    lower_speed_steps_s: int = 31
    upper_speed_steps_s: int = 2902
    speed_limit_steps_s: int = 12000  # largest value of PU
    counter_hz: float = 90e6  # CNF, E-series
    counter_bits: int = 32
    power_up_pan_steps: int = 0  # true position of the axes when not homed
    power_up_tilt_steps: int = 0
    hard_stop_margin_steps: int = 8  # from the factory limit to the end of travel
    serial: str = "E46-0001"
    model: str = "PTU-E46-17.5"
    version: str = ""  # reply to V, "" for that of the dialect
    faults: PtuFaults = PtuFaults()

    @property
    def resolution_arcsec(self) -> float:
        """Arc-seconds per step in the mode at power-up."""
        return self.full_step_arcsec / STEPS_PER_FULL_STEP[self.step_mode]


@dataclass(frozen=True, slots=True)
class HandSettings:
    """A person who turns the board. Numbers count attempts at turns or rests, from 1."""

    angle_std_deg: float = 0.5  # of a turn against a mark
    axis_std_deg: float = 0.5  # of the axis, in each direction
    tremor_deg: float = 0.03  # amplitude
    short_turns: tuple[int, ...] = ()  # turned by half of the angle only
    wrong_axes: tuple[int, ...] = ()  # turned about another axis
    early_turns: tuple[int, ...] = ()  # begun before the start signal
    late_turns: tuple[int, ...] = ()  # not finished in time
    moved_rests: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class BoardFaults:
    """Faults of a board. Numbers count frames or samples, from 1; 0 = never."""

    silent: bool = False
    garbage: bool = False  # only random bytes, no frames
    drop_frame_every: int = 0
    duplicate_frame_every: int = 0
    swap_frames_every: int = 0  # two neighbours exchanged
    flip_bit_every: int = 0
    garbage_every: int = 0
    reset_at_s: tuple[float, ...] = ()  # reboots, seconds after the origin
    reset_silence_s: float = 0.5


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """A GY-80 on a serial port or a CAN bus."""

    name: str = "GY80-1"
    odr_hz: float = 100.0  # nominal
    bandwidth_hz: float = 25.0
    full_scale_dps: float = 250.0
    count_mdps: float = 0.0  # per count, nominal; 0: as an L3G4200D with this full scale
    baud: int = 460800
    format: str = "gcb1"  # a protocol of `emulator.board.protocols`
    batch: int = 1  # samples per frame
    accel: bool = True
    text_separator: str = ","
    text_time: bool = True  # a text line starts with the board's u32 microseconds
    text_temperature: bool = True
    columns: ColumnMap | None = None  # of a text line, instead of these three
    signals: SignalMap | None = None  # of an IMU on a CAN bus
    options: Mapping[str, str | int | float | bool] = field(default_factory=dict)  # as in a rig
    slow_hz: float = 5.0
    faults: BoardFaults = BoardFaults()
    bus: str = ""  # its CAN bus, instead of a serial port
    node: int = 0


@dataclass(frozen=True, slots=True)
class BusSettings:
    """A CAN bus."""

    name: str
    bitrate: int = 1_000_000
    is_instant: bool = False  # the host's frames take no time, see `emulated_can_bus`


@dataclass(frozen=True, slots=True)
class InjectionRequest:
    """A cause to inject; omitted values are sampled from the seed. See `causes`."""

    cause: str  # an id of the catalogue, or `random`
    component: str = ""
    size: float | None = None


@dataclass(frozen=True, slots=True)
class RigSettings:
    """A whole emulated rig."""

    seed: int = 1  # of the true parameters
    session_seed: int | None = None  # of the noise of one session; None: it follows from `seed`
    ptu: PtuSettings | None = PtuSettings()
    hand: HandSettings | None = None  # a person instead of the unit
    boards: tuple[BoardSettings, ...] = (BoardSettings(),)
    buses: tuple[BusSettings, ...] = ()
    injections: tuple[InjectionRequest, ...] = ()
    prompt_unit: bool = False  # the host does not stall replies of the unit, as for a replay
    noise_free: bool = False  # no noise and no bias wander; counts are still rounded
    session_s: tuple[float, float] = (0.0, 60.0)  # since power-up; events are in its middle
    soak_k: float = (
        0.0  # temperature rise of the room, within the session, before it cools down again
    )
    latitude_deg: float | None = None  # of the site; sampled if unknown
    heading_deg: float | None = None
