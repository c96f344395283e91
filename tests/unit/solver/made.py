"""What the solver's tests make of a simulated rig: its reference, and samples of a board."""

from typing import Any

import numpy as np

from gyrorig_solver.data.clocks import ClockMap, map_clock
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.reference import PanTiltReference
from gyrorig_solver.reference.unit.move_fit import UnitPolls, fit_moves
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.unit_moves import MotionReader

RAD_PER_STEP = float(np.radians(185.142857 / 3600.0))


def reference_of(rig: Any) -> PanTiltReference:
    """The unit's motion, as the solver knows it from orders and polls."""
    settings = {
        f"{a}_{k}": v
        for a in ("pan", "tilt")
        for k, v in (("base_speed", 0.0), ("acceleration", 4000.0))
    }
    exchanges = [UnitExchange(a, b, True, c) for a, b, c in rig.exchanges]
    first = (int(rig.poll_steps[0][0]), int(rig.poll_steps[0][1]))
    motion = MotionReader(settings, first).read(translate_exchanges(exchanges))
    valid = np.ones((rig.poll_lo_s.size, 2), dtype=np.bool_)
    polls = UnitPolls(rig.poll_lo_s, rig.poll_hi_s, rig.poll_steps, valid)
    span = (float(rig.poll_lo_s[0]), float(rig.poll_hi_s[-1]))
    return PanTiltReference.of(motion, fit_moves(motion, polls), (RAD_PER_STEP, RAD_PER_STEP), span)


def samples_of(time_s: np.ndarray, rate: np.ndarray, clock: ClockMap | None = None) -> GyroSamples:
    """A board's samples; its clock is the host's where none is given."""
    n = time_s.size
    clock_map = clock or map_clock(np.rint(time_s * 1e6).astype(np.int64), time_s, 1e6, 64)
    return GyroSamples(
        board="B",
        metadata={"bandwidth_hz": "25"},
        origin_ns=0,
        time_s=clock_map.time_s,
        host_s=time_s,
        number=np.arange(n),
        segment=clock_map.segment,
        rate_rad_s=rate,
        usable=np.ones(n, np.bool_),
        accel_m_s2=None,
        temperature_degc=None,
        quantum_rad_s=1.527e-4,
        clock=clock_map,
        latency_bounds=None,
        lost=0,
        repeated=0,
        late=0,
    )
