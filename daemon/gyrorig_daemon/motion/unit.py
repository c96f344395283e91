"""An identified unit that is homed and at rest."""

from dataclasses import dataclass

from gyrorig_daemon.motion.pan_tilt_driver import PanTiltDriver
from gyrorig_daemon.motion.unit_facts import Homing, UnitFacts
from gyrorig_protocol.program import PtuSettings


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit that is ready to move, and what it can do."""

    driver: PanTiltDriver
    facts: UnitFacts


def open_unit(driver: PanTiltDriver, settings: PtuSettings, homing: Homing) -> Unit:
    """Prepare an identified unit; raises as `PanTiltDriver.set_up`."""
    return Unit(driver, driver.set_up(settings, homing))
