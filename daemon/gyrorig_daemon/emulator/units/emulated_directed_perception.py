"""Plays FLIR and Directed Perception units: PTU-E46, D46 and D48E."""

from dataclasses import replace

from gyrorig_daemon.emulator.emulator_settings import PtuSettings
from gyrorig_daemon.emulator.ptu import EmulatedPtu
from gyrorig_daemon.emulator.units.front_end import FrontEnd

# A client of a D48E prints its reply to PR, 23.142857 arc-seconds: a gear of 35:1 and eighth
# steps. Travel and speeds are assumptions, and nothing here is verified on a real D48E. The
# vendor's support page says that all E-series units run one firmware and command set.
D48E_FULL_STEP_ARCSEC = 185.142857
_STEPS_PER_DEG = 3600.0 * 8.0 / D48E_FULL_STEP_ARCSEC


def _adjust(settings: PtuSettings) -> PtuSettings:
    if settings.dialect != "d48e":
        return settings
    return replace(
        settings,
        dialect="e46",
        model="PTU-D48E",
        version="Pan-Tilt Controller v3.4.2r0(D48-C16/E), (C)1991-2014 FLIR Commercial Systems, "
        "Inc., All Rights Reserved",
        full_step_arcsec=D48E_FULL_STEP_ARCSEC,
        step_mode="E",
        pan_min_steps=round(-168.0 * _STEPS_PER_DEG),
        pan_max_steps=round(168.0 * _STEPS_PER_DEG),
        tilt_min_steps=round(-90.0 * _STEPS_PER_DEG),
        tilt_max_steps=round(30.0 * _STEPS_PER_DEG),
        base_speed_steps_s=round(5.0 * _STEPS_PER_DEG),
        speed_steps_s=round(30.0 * _STEPS_PER_DEG),
        acceleration_steps_s2=round(100.0 * _STEPS_PER_DEG),
        upper_speed_steps_s=round(100.0 * _STEPS_PER_DEG),
        speed_limit_steps_s=round(100.0 * _STEPS_PER_DEG),
        serial="D48E-0001",
    )


FRONT_END = FrontEnd(EmulatedPtu, _adjust)
