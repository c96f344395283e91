"""What to record where a motion leaves a parameter unobservable, by kind of reference."""

UNIT_REMEDIES = {
    "x": "tilt was not moved; move tilt at a few speeds",
    "y": "pan was swept at one tilt only, or not at all; "
    "sweep it at a positive and at a negative tilt",
    "z": "pan was not moved, or at one steep tilt only; "
    "sweep it at a positive and at a negative tilt",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing was accelerated; move and stop a few times",
}
REST_REMEDIES = {
    "x": "the board did not move; turn it about all three axes with a reference",
    "y": "the board did not move; turn it about all three axes with a reference",
    "z": "the board did not move; turn it about all three axes with a reference",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing moved; use a moving reference",
}
