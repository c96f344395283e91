"""Supply hum: a spectral line in the output, from the mains or the board's supply.

y_i += c_i cos(2 pi f t) + s_i sin(2 pi f t) at the samples' instants, coupled in after the sensing
element. Sampling aliases it and the block means attenuate it, and the model reproduces both. 50 or
60 Hz and their second harmonics; f is the true frequency, not the aliased one.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import shape_parameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)
MAINS_SPREAD_HZ = 0.1  # at 50 and 60 Hz; grids stay within +-0.2, mostly within +-0.05
MAX_LINES = 400


class SupplyHum(LinearTerm):
    """Cosine, then sine, for x, y, z each; then the frequency."""

    cause = "supply_hum"
    title = "The rates contain the mains frequency"
    equation = "y_i = y_i + cosine_i cos(2 pi frequency t) + sine_i sin(2 pi frequency t)"
    part = "sensor"
    stage = "readout"
    scope = "recording"
    parameters = (
        size_parameter("cosine", "rad/s", XYZ, typical=0.03, limit=5.0, prior_std=1.0, factor=DEG),
        size_parameter("sine", "rad/s", XYZ, typical=0.03, limit=5.0, prior_std=1.0, factor=DEG),
        shape_parameter(
            "frequency", "Hz", typical=0.01, lower=0.05, upper=2000.0, prior_std=100.0, start=50.0
        ),
    )
    confused_with = ("worm_error", "ringing")
    remedy = (
        "supply the board from a battery or a linear supply, and separate its ground from the "
        "motors' ground"
    )
    file_remedy = "ask the person who recorded the file what vibrates or hums at this frequency"
    covariates = ("bias_time",)
    picture = None
    template_search = "spectral_lines"
    excitation = "rests of at least ten seconds, because the hum is present at rest too"
    effect_if_ignored = (
        "small, because the frequency of the hum differs from that of the motion; the noise "
        "appears larger"
    )

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return cosine and sine on each axis, (6, blocks, 3)."""
        phase = 2.0 * np.pi * float(values[6]) * (state.sample_times_s - state.context.begin_s)
        waves = np.stack([np.cos(phase), np.sin(phase)])
        measured = state.block_means(on_all_axes(waves))
        return split_axes(measured)

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan the mains frequencies as finely as the recording resolves them.

        The search finds other lines in the residual's periodogram and refines them from there.
        """
        length_s = max(state.context.end_s - state.context.begin_s, 1.0)
        frequencies_hz = []
        for mains in MAINS_HZ:
            spread = MAINS_SPREAD_HZ * mains / 50.0
            count = min(MAX_LINES, 2 * int(np.ceil(2.0 * spread * length_s)) + 1)
            frequencies_hz.append(mains + np.linspace(-spread, spread, count))
        return scan_grid(self, frequency=np.concatenate(frequencies_hz))

    def describe(self, values: FloatArray) -> str:
        size = np.hypot(values[:3], values[3:6]) / DEG
        return (
            f"the rates have a spectral line at {values[6]:.2f} Hz: "
            f"{format_list(size, XYZ, 'deg/s')}"
        )


class OutOfBandHum(SupplyHum):
    """Hum that cannot be tested, because mains lines are faster than a reference of attitudes."""

    def missing_data(self, state: SignalState) -> str | None:
        """Return that the reference has only slow rates."""
        del state
        return "the fit compares only slow rates with the reference; record the board at rest"


SupplyHum.attitude_form = OutOfBandHum()
TERM = SupplyHum()
