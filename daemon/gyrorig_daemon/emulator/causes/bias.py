"""Causes that move the bias. Sizes: rig discovery survey, section 2; boards survey, 1.1, 1.4."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    Cause,
    Draw,
    Hidden,
    Quantity,
    board_of,
)
from gyrorig_daemon.emulator.physics.effects.bias import (
    Hum,
    Ramp,
    RandomWalk,
    Step,
    ThermalBias,
    WarmUp,
)
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks

_MAINS_HZ = (50.0, 60.0)
_MAINS_SPREAD = 1e-3  # of the mains' frequency, a usual day


def _thermal(draw: Draw) -> dict[str, Quantity]:
    lag_s = float(draw.rng.uniform(10.0, 40.0))
    return {"slope": draw.by_axis("rad/s/K"), "lag": Quantity(lag_s, "s")}


def _hang_thermal(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    effect = ThermalBias(hidden.array("slope"), hidden.number("lag"))
    board_of(hidden, hooks).biases.append(effect)


def _warm_up(draw: Draw) -> dict[str, Quantity]:
    time_constant_s = float(draw.rng.uniform(30.0, 120.0))
    start = draw.by_axis("rad/s")
    return {"at_power_up": start, "time_constant": Quantity(time_constant_s, "s")}


def _hang_warm_up(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    effect = WarmUp(hidden.array("at_power_up"), hidden.number("time_constant"))
    board_of(hidden, hooks).biases.append(effect)


def _ramp(draw: Draw) -> dict[str, Quantity]:
    return {"slope": draw.by_axis("rad/s^2")}


def _hang_ramp(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).biases.append(Ramp(hidden.array("slope")))


def _step(draw: Draw) -> dict[str, Quantity]:
    return {"step": draw.by_axis("rad/s"), "at": Quantity(draw.event_s(), "s")}


def _hang_step(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).biases.append(Step(hidden.array("step"), hidden.number("at")))


def _walk(draw: Draw) -> dict[str, Quantity]:
    walk = (abs(number) for number in draw.by_axis("rad/s/sqrt(s)").array.tolist())
    return {"walk": Quantity(tuple(walk), "rad/s/sqrt(s)")}


def _hang_walk(hidden: Hidden, hooks: RigHooks, rng: np.random.Generator) -> None:
    board_of(hidden, hooks).biases.append(RandomWalk(hidden.array("walk"), rng))


def _hum(draw: Draw) -> dict[str, Quantity]:
    mains_hz = float(draw.rng.choice(_MAINS_HZ))
    mains_hz *= 1.0 + _MAINS_SPREAD * float(draw.rng.uniform(-1.0, 1.0))
    return {
        "amplitude": draw.by_axis("rad/s"),
        "frequency": Quantity(mains_hz, "Hz"),
        "phase": Quantity(draw.phase_rad(), "rad"),
    }


def _hang_hum(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    effect = Hum(hidden.array("amplitude"), hidden.number("frequency"), hidden.number("phase"))
    board_of(hidden, hooks).biases.append(effect)


CAUSES = (
    Cause(
        "thermal_bias", "largest slope of the bias with the die's temperature",
        "sensor", "rad/s/K", 5e-4, 1e-4, 2e-3, 0.1, _thermal, _hang_thermal,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "warm_up", "largest bias at power-up that fades away",
        "sensor", "rad/s", 1.7e-3, 8e-4, 5e-3, 0.5, _warm_up, _hang_warm_up,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "bias_ramp", "largest slope of the bias with time",
        "sensor", "rad/s^2", 1.5e-5, 3e-6, 1e-4, 1e-2, _ramp, _hang_ramp,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "bias_step", "largest jump of the bias, once",
        "sensor", "rad/s", 1e-3, 3e-4, 3e-3, 0.5, _step, _hang_step,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "bias_random_walk", "largest random walk on top of the sensor's own",
        "sensor", "rad/s/sqrt(s)", 5e-5, 2e-5, 2e-4, 1e-2, _walk, _hang_walk,
        places=SENSOR_AXES, together=True, signed=False,
    ),
    Cause(
        "supply_hum", "largest amplitude of the mains' hum",
        "sensor", "rad/s", 1e-3, 3e-4, 5e-3, 0.5, _hum, _hang_hum,
        places=SENSOR_AXES, together=True, signed=False,
    ),
)  # fmt: skip
