"""One session of a rig on a fixed grid of 4 kHz: its motion, its rates, and its samples.

What to use when: `Scene` for a session with known moves; `Scene.simulate_rates` with and without
hidden effects, at the same instants. The difference of two such rates is the signal of the effects.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray
from tests.bench.rigs.gyroscope import FULL_SCALE_RAD_S, element_rad_s
from tests.bench.rigs.prior_sizes import AXES, HiddenCauses
from tests.bench.rigs.rig import FINE_HZ, MARGIN_S, SAMPLES_AFTER_S, SAMPLES_BEFORE_S
from tests.bench.rigs.samples import TEMPERATURE_OFFSET_DEGC
from tests.bench.rigs.serial_session import SerialSession
from tests.bench.rigs.stage_motion import StageMotion, StepTracks, stage_motion, step_tracks
from tests.hidden.independent.effects.effect import Effect
from tests.hidden.independent.low_passes import LowPass
from tests.hidden.independent.parts import RigParts

NO_CAUSES, NO_EFFECT = HiddenCauses(), Effect()


@dataclass(frozen=True, slots=True, eq=False)
class GridRates:
    """Rates behind the low-pass on the grid, and the bias parts at the samples."""

    begin_s: float  # of the grid
    grid_rad_s: FloatArray  # (m, 3)
    sample_s: FloatArray  # (n,)
    lag_s: FloatArray  # (n,), of a queue on the board
    bias_parts_rad_s: dict[str, FloatArray]  # (n, 3), by cause
    limit_rad_s: float

    def sample_rates(self, shift_s: float = 0.0) -> FloatArray:
        """Return the rates of the samples, (n, 3); each sample is later by `shift_s`."""
        taken_s = self.sample_s - self.lag_s + shift_s
        rates = interpolate_rows(self.grid_rad_s, (taken_s - self.begin_s) * FINE_HZ)
        for part in self.bias_parts_rad_s.values():
            rates = rates + part
        return np.clip(rates, -self.limit_rad_s, self.limit_rad_s)

    def compute_slope_rad_s2(self) -> FloatArray:
        """Return the time derivative of the rates, (n, 3)."""
        step_s = 1.0 / FINE_HZ
        return np.asarray((self.sample_rates(step_s) - self.sample_rates(-step_s)) / (2.0 * step_s))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A rig and one of its sessions, with fixed start times of the moves."""

    parts: RigParts
    session: SerialSession  # its moves have the profile without causes

    @property
    def span_s(self) -> tuple[float, float]:
        """Begin and end of the samples."""
        return SAMPLES_AFTER_S, self.session.end_s - SAMPLES_BEFORE_S

    @property
    def moves_s(self) -> list[tuple[int, float]]:
        """Axis and begin of each move."""
        return [(move.axis, move.start_s) for move in self.session.moves]

    def simulate_tracks(self, causes: HiddenCauses, effect: Effect = NO_EFFECT) -> StepTracks:
        """Return the steps of both axes; an effect turns the stage, not the counts."""
        cells = int((self.session.end_s + 2.0 * MARGIN_S) * FINE_HZ)
        edges_s = -MARGIN_S + np.arange(cells + 1) / FINE_HZ
        tracks = step_tracks(change_moves(self.session, causes), causes, edges_s)
        added = effect.added_angles_rad(tracks)
        turned = [t + a / RAD_PER_STEP for t, a in zip(tracks.turned, added, strict=True)]
        return replace(tracks, turned=(turned[0], turned[1]))

    def simulate_motion(self, causes: HiddenCauses, effect: Effect = NO_EFFECT) -> StageMotion:
        """Return the motion of the stage."""
        return stage_motion(
            self.simulate_tracks(causes, effect), causes, self.span_s, self.parts.lean_rad
        )

    def simulate_rates(
        self,
        causes: HiddenCauses = NO_CAUSES,
        effect: Effect = NO_EFFECT,
        noise_rng: np.random.Generator | None = None,
        low_pass: LowPass | None = None,
    ) -> GridRates:
        """Return the rates with hidden effects.

        Args:
            causes: of the catalogue.
            effect: outside the catalogue.
            noise_rng: of the white noise in front of the low-pass; None: without noise.
            low_pass: instead of the sensor's own.
        """
        board, motion = self.parts.make_gyroscope(causes), self.simulate_motion(causes, effect)
        element = element_rad_s(board, motion, causes, self.span_s)
        element = element + effect.added_rates_rad_s(motion, self.span_s)
        quiet = element[0].copy()
        element -= quiet
        if noise_rng is not None:
            white = np.array([level.white for level in board.levels])
            amplitude = effect.noise_amplitude(motion, self.span_s)
            scale = np.sqrt(0.5 / motion.cell_s) * amplitude[:, None] * white
            element += noise_rng.normal(size=element.shape) * scale
        cutoff_hz = board.cutoff_hz(causes)
        lags_s = board.lag_s + effect.axis_lags_s()
        grid = _filter_signal(
            low_pass or self.parts.low_pass, cutoff_hz, lags_s, element, motion.cell_s
        )
        sample_s = self.parts.compute_sample_times_s(self.span_s)
        limit = 1.0 - causes.get("saturation")
        return GridRates(
            begin_s=-MARGIN_S,
            grid_rad_s=grid + quiet + board.bias_rad_s,
            sample_s=sample_s,
            lag_s=causes.get("clock_step") * self._mark_since_event("clock_step", causes, sample_s),
            bias_parts_rad_s=self._compute_bias_parts(causes, sample_s),
            limit_rad_s=FULL_SCALE_RAD_S * (max(0.05, limit) if limit < 1.0 else 2.0),
        )

    def _mark_since_event(
        self, cause: str, causes: HiddenCauses, sample_s: FloatArray
    ) -> FloatArray:
        """Return 1 for the samples since a cause's event, else 0."""
        begin_s, end_s = self.span_s
        event_s = begin_s + causes.get(cause, "at") * (end_s - begin_s)
        return np.where(sample_s >= event_s, 1.0, 0.0)

    def _compute_bias_parts(
        self, causes: HiddenCauses, sample_s: FloatArray
    ) -> dict[str, FloatArray]:
        since_s, long_s = sample_s - self.span_s[0], self.span_s[1] - self.span_s[0]
        die = self.parts.gyroscope.warming.die_degc(since_s, long_s) - TEMPERATURE_OFFSET_DEGC
        warm_s = causes.get("warm_up", "time_s") or 1.0
        turns = causes.get("supply_hum", "line_hz") * sample_s
        shapes = {
            "thermal_bias": die,
            "warm_up": np.exp(-since_s / warm_s),
            "bias_ramp": since_s - long_s / 2.0,
            "bias_step": self._mark_since_event("bias_step", causes, sample_s),
            "supply_hum": np.sin(2.0 * np.pi * turns + causes.get("supply_hum", "phase")),
        }
        return {
            cause: np.outer(shape, causes.of_axes(cause))
            for cause, shape in shapes.items()
            if cause in causes.values
        }


def change_moves(session: SerialSession, causes: HiddenCauses) -> SerialSession:
    """Return a session whose moves have the profile under given causes.

    Without these causes the ramps are exactly as commanded, because a timer error would be a cause.
    """
    moves = []
    for move in session.moves:
        axis = AXES[move.axis]
        share = 1.0 + causes.get("acceleration_error", axis)
        jump = causes.get("base_speed_jump", axis) / RAD_PER_STEP
        moves.append(
            replace(
                move,
                acceleration_steps_s2=session.ramp_steps_s2 * share,
                base_steps_s=session.base_steps_s + jump,
            )
        )
    return replace(session, moves=tuple(moves))


def interpolate_rows(values: FloatArray, positions: FloatArray) -> FloatArray:
    """Interpolate rows at fractional row numbers, by cubics through four rows."""
    k = np.clip(np.floor(positions).astype(np.int64), 1, values.shape[0] - 3)
    u = (positions - k)[:, None]
    before, now, then, after = (values[k + j] for j in (-1, 0, 1, 2))
    return np.asarray(
        before * (-u * (u - 1) * (u - 2) / 6)
        + now * ((u + 1) * (u - 1) * (u - 2) / 2)
        - then * ((u + 1) * u * (u - 2) / 2)
        + after * ((u + 1) * u * (u - 1) / 6)
    )


def _filter_signal(
    low_pass: LowPass, cutoff_hz: float, lags_s: FloatArray, element: FloatArray, cell_s: float
) -> FloatArray:
    """Return a signal of cells behind the low-pass and the lag, at the begin of each cell."""
    size = next_fast_len(element.shape[0], real=True)
    f = rfftfreq(size, cell_s)
    # The value of a cell is a mean over the cell, at its middle.
    response = low_pass.compute_response(f, cutoff_hz) / np.sinc(f * cell_s)
    late = np.exp(-2j * np.pi * np.outer(f, lags_s + 0.5 * cell_s))
    spectrum = rfft(element, size, axis=0) * (response[:, None] * late)
    return np.asarray(irfft(spectrum, size, axis=0)[: element.shape[0]])
