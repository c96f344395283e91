"""Low-pass filters of sensors that are not the second-order Butterworth of the emulator.

Each filter has its -3 dB point at the stated bandwidth. `FILTERS` has one entry for each kind.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.bench.accuracy.profile import FloatArray

ComplexArray = NDArray[np.complex128]
TWO_POLES_RATIO = float(np.sqrt(np.sqrt(2.0) - 1.0))  # bandwidth over pole, two equal poles
BOXCAR_RATIO = 0.442947  # bandwidth times length, of a mean over a window


@dataclass(frozen=True, slots=True)
class LowPass:
    """One kind of low-pass, in units of its bandwidth.

    Attributes:
        response: of frequencies in units of the bandwidth.
        delay: at frequency zero, times the bandwidth.
    """

    kind: str
    response: Callable[[FloatArray], ComplexArray]
    delay: float

    def at(self, frequency_hz: FloatArray, bandwidth_hz: float) -> ComplexArray:
        """Return the complex response at frequencies."""
        return self.response(frequency_hz / bandwidth_hz)

    def delay_s(self, bandwidth_hz: float) -> float:
        """Return the delay of slow signals."""
        return self.delay / bandwidth_hz


def _first_order(share: FloatArray) -> ComplexArray:
    return np.asarray(1.0 / (1.0 + 1j * share), dtype=np.complex128)


def _two_poles(share: FloatArray) -> ComplexArray:
    return _first_order(share * TWO_POLES_RATIO) ** 2


def _third_order(share: FloatArray) -> ComplexArray:
    s = 1j * share
    return np.asarray(1.0 / ((1.0 + s) * (1.0 + s + s**2)), dtype=np.complex128)


def _boxcar(share: FloatArray) -> ComplexArray:
    windows = share * BOXCAR_RATIO
    return np.asarray(np.sinc(windows) * np.exp(-1j * np.pi * windows), dtype=np.complex128)


def _butterworth(share: FloatArray) -> ComplexArray:
    s = 1j * share
    return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * s + s**2), dtype=np.complex128)


_TURN = 2.0 * np.pi
FILTERS: Mapping[str, LowPass] = {
    low_pass.kind: low_pass
    for low_pass in (
        LowPass("first_order", _first_order, 1.0 / _TURN),
        LowPass("two_equal_poles", _two_poles, 2.0 * TWO_POLES_RATIO / _TURN),
        LowPass("third_order", _third_order, 2.0 / _TURN),
        LowPass("boxcar_decimator", _boxcar, BOXCAR_RATIO / 2.0),
    )
}
# Not drawn. It is what the solver assumes; the answer compares the drawn filter with it.
ASSUMED = LowPass("butterworth", _butterworth, float(np.sqrt(2.0)) / _TURN)
