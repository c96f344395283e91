"""Instructions for recording if a motion leaves a parameter unobservable, by kind of reference."""

UNIT_REMEDIES = {
    "x": "tilt did not move; move tilt at a few speeds",
    "y": (
        "pan moved at only one tilt angle, or not at all; sweep pan at a positive and at a "
        "negative tilt angle"
    ),
    "z": (
        "pan did not move, or moved at only one steep tilt angle; sweep pan at a positive and at "
        "a negative tilt angle"
    ),
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "the board was never accelerated; start and stop the unit a few times",
}
REST_REMEDIES = {
    "x": "the board did not move; turn it about all three axes with a reference",
    "y": "the board did not move; turn it about all three axes with a reference",
    "z": "the board did not move; turn it about all three axes with a reference",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "the board did not move; use a reference that moves",
}
