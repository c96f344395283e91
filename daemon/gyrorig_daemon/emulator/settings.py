"""What an emulated rig is told to be: the unit, the boards, their faults, the seed.

Everything a test may want to vary is a field here; everything that is hidden from the
client and drawn from the seed is in `truth`.
"""

from dataclasses import dataclass
from typing import Literal

Dialect = Literal["d46", "e46"]

StepMode = Literal["F", "H", "Q", "E", "A"]  # full, half, quarter, eighth, auto

# 17.5:1 gear, 200 full steps a turn: 360 deg / 3500; half of it is the 185.1428 arc-seconds
# of the D46 user's manual v2.14.
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
    """What goes wrong on the unit's line. Numbers count replies since power-up, from 1."""

    silent: bool = False  # never answers
    lose_byte_every: int = 0  # every n-th reply loses a byte; 0 = never
    garbage_every: int = 0  # garbage before every n-th reply
    error_every: int = 0  # every n-th command is answered as illegal and not done
    lose_steps_at_s: float | None = None  # once, `lost_steps` of pan vanish unseen
    lost_steps: int = 0


@dataclass(frozen=True, slots=True)
class PtuSettings:
    """A PTU-E46 or D46 and its state when the port is opened."""

    dialect: Dialect = "e46"
    baud: int = 9600
    command_time_ms: float = 1.0  # 1, 10 or 20 (E-series), 100 (D-series by the vendor)
    sample_fraction: float = 0.5  # the count is taken at this part of the command time
    echo: bool = True
    verbose: bool = True
    leading_lf_on_cr: bool = True  # with echo off a reply to CR begins with LF
    acceleration_text: Literal["sec^2", "sec/sec"] = "sec^2"
    banner: bool = False
    homed: bool = True
    sweep_at_power_up: bool = False  # homes by itself first, then shows its banner
    homing_speed_steps_s: float = 2000.0
    recompute_s: float = 3.0  # PA, PB, PU: tables are computed anew
    unit_id: int = 0  # other than 0: silent until selected
    step_mode: StepMode = "H"  # at power-up; steps below count in it
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
    speed_limit_steps_s: int = 12000  # what PU may be raised to
    counter_hz: float = 90e6  # CNF, E-series
    counter_bits: int = 32
    power_up_pan_steps: int = 0  # where the axes really are when not homed
    power_up_tilt_steps: int = 0
    hard_stop_margin_steps: int = 8  # from the factory limit to the end of travel
    serial: str = "E46-0001"
    faults: PtuFaults = PtuFaults()

    @property
    def resolution_arcsec(self) -> float:
        """Arc-seconds a step in the mode at power-up."""
        return self.full_step_arcsec / STEPS_PER_FULL_STEP[self.step_mode]


@dataclass(frozen=True, slots=True)
class BoardFaults:
    """What goes wrong on a board. Numbers count frames or samples, from 1; 0 = never."""

    silent: bool = False
    garbage: bool = False  # only noise comes, no frame
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
    baud: int = 460800
    format: Literal["gcb1", "text"] = "gcb1"
    batch: int = 1  # samples a frame
    accel: bool = True
    text_separator: str = ","
    text_time: bool = True  # a text line begins with the board's u32 microseconds
    text_temperature: bool = True
    slow_hz: float = 5.0
    faults: BoardFaults = BoardFaults()
    bus: str = ""  # the CAN bus that it is on, instead of a serial port
    node: int = 0


@dataclass(frozen=True, slots=True)
class BusSettings:
    """A CAN bus."""

    name: str
    bitrate: int = 1_000_000
    is_instant: bool = False  # the host's frames take no time: see `can_bus`


@dataclass(frozen=True, slots=True)
class HideOrder:
    """What to hide in a rig; see `causes`. What is left out is drawn from the seed."""

    cause: str  # an id of the catalogue, or `random`
    place: str = ""
    size: float | None = None


@dataclass(frozen=True, slots=True)
class RigSettings:
    """A whole emulated rig."""

    seed: int = 1
    ptu: PtuSettings | None = PtuSettings()
    boards: tuple[BoardSettings, ...] = (BoardSettings(),)
    buses: tuple[BusSettings, ...] = ()
    hide: tuple[HideOrder, ...] = ()
    noise_free: bool = False  # the sensors neither scatter nor wander; words stay rounded
    session_s: tuple[float, float] = (0.0, 60.0)  # since power-up: events come in its middle
    soak_k: float = 0.0  # the room warms up by this and cools down again within the session
    latitude_deg: float | None = None  # of the site; unknown: drawn where it is needed
    heading_deg: float | None = None
