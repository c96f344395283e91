"""Low-pass filters of sensors, of another order than the second-order Butterworth of the emulator.

`MILD` filters are that Butterworth with one more stage. The length of the stage is such that the
solver's assumption is nearly true. `STRONG` filters have a different order, with the -3 dB point at
the stated bandwidth.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.bench.accuracy.profile import FloatArray

ComplexArray = NDArray[np.complex128]
Response = Callable[[FloatArray], ComplexArray]
TURN = 2.0 * np.pi
TWO_POLES_RATIO = float(np.sqrt(np.sqrt(2.0) - 1.0))  # bandwidth over pole, two equal poles
BOXCAR_RATIO = 0.442947  # bandwidth times length, of a mean over a window


@dataclass(frozen=True, slots=True)
class Stage:
    """One more stage behind the low-pass, in units of its time.

    Attributes:
        response: of frequencies times the stage's time.
        delay: at frequency zero, over the stage's time.
    """

    response: Response
    delay: float


@dataclass(frozen=True, slots=True)
class LowPass:
    """A low-pass in units of its bandwidth, and one more stage in units of its time.

    Attributes:
        response: of frequencies in units of the bandwidth.
        delay: at frequency zero, times the bandwidth.
    """

    kind: str
    response: Response
    delay: float
    stage: Stage | None = None
    stage_s: float = 0.0

    def compute_response(self, frequency_hz: FloatArray, bandwidth_hz: float) -> ComplexArray:
        """Return the complex response at frequencies."""
        response = self.response(frequency_hz / bandwidth_hz)
        if self.stage is None or self.stage_s == 0.0:
            return response
        return response * self.stage.response(frequency_hz * self.stage_s)

    def compute_delay_s(self, bandwidth_hz: float) -> float:
        """Return the delay of slow signals."""
        added_s = 0.0 if self.stage is None else self.stage.delay * self.stage_s
        return self.delay / bandwidth_hz + added_s


def _pole(share: FloatArray) -> ComplexArray:
    return np.asarray(1.0 / (1.0 + 1j * TURN * share), dtype=np.complex128)


def _two_poles(share: FloatArray) -> ComplexArray:
    return _pole(share) ** 2


def _window(share: FloatArray) -> ComplexArray:
    return np.asarray(np.sinc(share) * np.exp(-1j * np.pi * share), dtype=np.complex128)


def _first_order(share: FloatArray) -> ComplexArray:
    return _pole(share / TURN)


def _equal_poles(share: FloatArray) -> ComplexArray:
    return _first_order(share * TWO_POLES_RATIO) ** 2


def _third_order(share: FloatArray) -> ComplexArray:
    s = 1j * share
    return np.asarray(1.0 / ((1.0 + s) * (1.0 + s + s**2)), dtype=np.complex128)


def _boxcar(share: FloatArray) -> ComplexArray:
    return _window(share * BOXCAR_RATIO)


def _butterworth(share: FloatArray) -> ComplexArray:
    s = 1j * share
    return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * s + s**2), dtype=np.complex128)


BUTTERWORTH_DELAY = float(np.sqrt(2.0)) / TURN
# The solver assumes this filter. No rig has it; `draws` compares the filter of a rig with it.
ASSUMED = LowPass("butterworth", _butterworth, BUTTERWORTH_DELAY)
MILD: Mapping[str, LowPass] = {
    kind: LowPass(kind, _butterworth, BUTTERWORTH_DELAY, stage)
    for kind, stage in (
        ("third_order", Stage(_pole, 1.0)),
        ("fourth_order", Stage(_two_poles, 2.0)),
        ("averaged", Stage(_window, 0.5)),  # a decimator that averages
    )
}
STRONG: Mapping[str, LowPass] = {
    low_pass.kind: low_pass
    for low_pass in (
        LowPass("first_order", _first_order, 1.0 / TURN),
        LowPass("two_equal_poles", _equal_poles, 2.0 * TWO_POLES_RATIO / TURN),
        LowPass("third_order_butterworth", _third_order, 2.0 / TURN),
        LowPass("boxcar_decimator", _boxcar, BOXCAR_RATIO / 2.0),
    )
}
