"""Draw the parts of one rig from a seed: sensor, filter, noise, sample clock, link, line.

The spreads follow data sheets of consumer parts (L3G4200D, MPU-6050, BMI270). The emulator has
other spreads.
"""

from dataclasses import dataclass, replace

import numpy as np
from tests.bench.accuracy.noise import Levels
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import Gyroscope, draw_gyroscope
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.rig import BAUDS, COUNTER_SHARE, LEAN_STD_RAD
from tests.hidden.independent.low_passes import MILD, STRONG, LowPass

MDPS = float(np.radians(1e-3))
WHITE_RAD_S_RTHZ = (10.0 * MDPS, 30.0 * MDPS)
FLICKER_RAD_S = 4.0 * MDPS
WALK_RAD_S_RTS = 0.3 * MDPS
MOST_SPREAD = 3.0  # largest factor of flicker and walk between parts, in both directions
AXIS_SPREAD = (0.8, 1.25)
FLOOR_SHARE = (0.0, 0.3)  # noise behind the low-pass, as a share of the white noise
ODR_STD, MOST_ODR_ERROR = 0.02, 0.05
ODR_PER_K_STD = 2e-4
USB_SHARE = 0.5  # share of rigs with a USB link with frames of 1 ms
USB_FRAME_S = 1e-3
CRYSTAL_STD = 3e-5
STAGE_SHARE = (0.1, 0.6)  # time of a mild filter's stage, relative to the time of its bandwidth
FILTERS = ("mild", "strong")
LATENCY_S, LATENCY_EXTRA_S = (3e-4, 3e-3), 1.5e-4


@dataclass(frozen=True, slots=True)
class Link:
    """The link that carries samples from the board to the host."""

    shortest_s: float
    extra_s: float  # mean of the random delay
    frame_s: float  # samples wait for the next frame; 0: they do not wait

    def compute_arrival_s(self, ready_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the arrival times of samples that are ready at given times."""
        sent_s = ready_s + self.shortest_s
        if self.frame_s > 0.0:
            sent_s = np.ceil(sent_s / self.frame_s) * self.frame_s
        late_s = sent_s + rng.exponential(self.extra_s, size=ready_s.size)
        return np.asarray(np.maximum.accumulate(late_s))

    @property
    def kind(self) -> str:
        """The name in the answer."""
        return "usb_frames" if self.frame_s > 0.0 else "serial"


@dataclass(frozen=True, slots=True, eq=False)
class RigParts:
    """The parts of a rig, which are the same in all its sessions."""

    seed: int
    baud: float
    has_counter: bool
    gyroscope: Gyroscope
    low_pass: LowPass
    floor_rad_s_rthz: float  # noise behind the low-pass
    odr_per_k: float  # relative change of the sample rate
    link: Link
    crystal_skew: float  # of the board's time stamps
    lean_rad: FloatArray  # (2,), of the base
    counter_start: int
    counter_skew: float

    def make_gyroscope(self, causes: HiddenCauses) -> Gyroscope:
        """Return the gyroscope with the thermometer lag of the causes."""
        lag_s = causes.get("thermal_bias", "lag_s")
        warming = replace(self.gyroscope.warming, thermometer_lag_s=lag_s)
        return replace(self.gyroscope, warming=warming)

    def compute_sample_times_s(self, span_s: tuple[float, float]) -> FloatArray:
        """Return the sample times; the sample rate follows the temperature of the die."""
        grid_s = np.arange(span_s[0], span_s[1], 0.05)
        die = self.gyroscope.warming.die_degc(grid_s - span_s[0], span_s[1] - span_s[0])
        rate_hz = self.gyroscope.odr_hz * (1.0 + self.odr_per_k * (die - die[0]))
        steps = np.diff(grid_s) * (rate_hz[1:] + rate_hz[:-1]) / 2.0
        number = np.concatenate([[0.0], np.cumsum(steps)])
        return np.asarray(np.interp(np.arange(int(number[-1])), number, grid_s))

    def compute_delay_s(self, causes: HiddenCauses) -> float:
        """Return the delay of the time stamps behind a slow motion."""
        cutoff_hz = self.gyroscope.cutoff_hz(causes)
        return (
            self.gyroscope.lag_s + self.low_pass.compute_delay_s(cutoff_hz) + self.link.shortest_s
        )


def draw_parts(seed: int, filters: str = "mild") -> RigParts:
    """Return the rig of a seed.

    Args:
        seed: of all draws.
        filters: kind of the low-pass filters, one of `FILTERS`.
    """
    rng = np.random.default_rng([seed, 0x50415254])
    board_rng = rng.spawn(1)[0]
    gyroscope = draw_gyroscope(board_rng, HiddenCauses())
    quantum = gyroscope.quantum_rad_s
    white = float(np.exp(rng.uniform(*np.log(WHITE_RAD_S_RTHZ))))
    flicker, walk = FLICKER_RAD_S * _draw_spread(rng), WALK_RAD_S_RTS * _draw_spread(rng)
    levels = [_draw_axis_levels(white, flicker, walk, quantum, rng) for _ in range(3)]
    error = float(np.clip(rng.normal(scale=ODR_STD), -MOST_ODR_ERROR, MOST_ODR_ERROR))
    gyroscope = replace(
        gyroscope,
        levels=(levels[0], levels[1], levels[2]),
        odr_hz=gyroscope.nominal_hz * (1.0 + error),
    )
    return RigParts(
        seed=seed,
        baud=float(rng.choice(BAUDS)),
        has_counter=bool(rng.uniform() < COUNTER_SHARE),
        gyroscope=gyroscope,
        low_pass=_draw_low_pass(filters, gyroscope.bandwidth_hz, rng.spawn(1)[0]),
        floor_rad_s_rthz=white * float(rng.uniform(*FLOOR_SHARE)),
        odr_per_k=float(rng.normal(scale=ODR_PER_K_STD)),
        link=Link(
            shortest_s=float(rng.uniform(*LATENCY_S)),
            extra_s=LATENCY_EXTRA_S,
            frame_s=USB_FRAME_S if rng.uniform() < USB_SHARE else 0.0,
        ),
        crystal_skew=float(rng.normal(scale=CRYSTAL_STD)),
        lean_rad=rng.normal(scale=LEAN_STD_RAD, size=2),
        counter_start=int(rng.integers(2**32)),
        counter_skew=float(rng.normal(scale=2e-5)),
    )


def _draw_low_pass(filters: str, bandwidth_hz: float, rng: np.random.Generator) -> LowPass:
    if filters == "strong":
        return STRONG[str(rng.choice(list(STRONG)))]
    low_pass = MILD[str(rng.choice(list(MILD)))]
    share = float(np.exp(rng.uniform(*np.log(STAGE_SHARE))))
    return replace(low_pass, stage_s=share / (2.0 * np.pi * bandwidth_hz))


def _draw_spread(rng: np.random.Generator) -> float:
    most = float(np.log(MOST_SPREAD))
    return float(np.exp(np.clip(rng.normal(scale=most / 2.0), -most, most)))


def _draw_axis_levels(
    white: float, flicker: float, walk: float, quantum_rad_s: float, rng: np.random.Generator
) -> Levels:
    a, b, c = (float(rng.uniform(*AXIS_SPREAD)) for _ in range(3))
    return Levels(white * a, flicker * b, walk * c, quantum_rad_s)
