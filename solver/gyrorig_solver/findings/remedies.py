"""What to do at the rig about a cause that was found."""

from types import MappingProxyType

_TAKE_IN = "or keep it in the model (gyrorig solve --extend auto)"

REMEDIES = MappingProxyType(
    {
        "clock_offset": "nothing: the time offset of the calibration takes it in",
        "clock_skew": "stamp samples by the board's own clock, not by counting at the nominal "
        "output rate",
        "clock_step": "do not suspend the host or set its clock while recording; look for "
        "USB re-enumeration in its log",
        "lost_samples": "send a sequence number with every sample, lower the output rate, or "
        "raise the line's baud rate",
        "repeated_samples": "read the sensor at its data-ready line or at its own rate",
        "sample_jitter": "stamp samples at the data-ready interrupt of the board",
        "corrupt_samples": "add a check sum to the frame, read in one burst, look at the cable",
        "axis_swap": "mend the order of the words in the driver or in the board's columns",
        "sign_flip": "mend the sign in the driver or in the board's columns",
        "wrong_full_scale": "read the range register back and set the board's full scale to it",
        "low_pass_lag": "read the bandwidth register back, and give that bandwidth_hz in the rig's "
        "configuration",
        "scale_quadratic": f"take it for the part's own, {_TAKE_IN}; compare with a second board",
        "scale_cubic": f"take it for the part's own, {_TAKE_IN}; use a larger full scale",
        "scale_asymmetry": f"take it for the part's own, {_TAKE_IN}",
        "saturation": "use a larger full scale, or turn slower",
        "dead_zone": f"look for a filter or a threshold in the board's firmware, {_TAKE_IN}",
        "g_sensitivity": f"take it for the part's own, {_TAKE_IN}",
        "vibration_rectification": "mount the board on a stiffer plate, away from the motor; use "
        "half steps",
        "thermal_bias": "let the board warm up before recording, keep draughts off, "
        f"{_TAKE_IN} (it needs the board's thermometer)",
        "thermal_scale": f"record at the temperature of use, {_TAKE_IN}",
        "warm_up": "switch the board on ten minutes before recording",
        "bias_ramp": "let the board warm up before recording, or record for longer",
        "bias_step": "look for a change of supply, load or light at that moment; record again",
        "bias_random_walk": "nothing at the rig: the standard deviations allow for it",
        "supply_hum": "feed the board from a battery or a linear supply, and part its ground from "
        "the motors'",
        "motor_coupling": "feed the board apart from the motors, and lead their cables apart",
        "backlash": f"have the worm adjusted; arrive at every rest from the same side; {_TAKE_IN}",
        "lost_steps": "lower the acceleration or the load, check the gear for obstacles, and home "
        "the unit again",
        "eccentricity": f"have the gear's seat looked at; turn over the full range, {_TAKE_IN}",
        "worm_error": f"it is the worm's own: turn over whole turns of it (20.57 deg), {_TAKE_IN}",
        "axis_nonorthogonality": f"have the tilt axis shimmed, {_TAKE_IN}",
        "tilt_zero": "level the unit and set tilt_zero in the rig's configuration",
        "step_resolution": "ask the unit for its resolution (PR, TR), and set what it says",
        "acceleration_error": "ask the unit for its acceleration (PA, TA), and note it in the "
        "recording",
        "s_curve": f"the controller rounds its ramps: {_TAKE_IN}",
        "base_speed_jump": "ask the unit for its base speed (PB, TB), and note it in the recording",
        "ringing": "lower the acceleration, stiffen the mount, wait longer before resting",
        "tilt_sag": "balance the payload over the tilt axis",
        "base_compliance": "bolt the unit's foot to something heavy and stiff",
        "board_slip": "fasten the board again, and record again: the calibration holds for a "
        "mount that does not move",
        "reference_smoothing": "export the attitudes unfiltered and at the camera's own rate, with "
        "short exposures; or compare slow turns only",
        "earth_rotation": "give latitude_deg and heading_deg of the site",
    }
)


def remedy(cause: str) -> str:
    """Return what to do about a cause, "" where nothing is known."""
    return REMEDIES.get(cause, "")
