"""The motion of a pan-tilt unit, reconstructed from its commands and position replies.

What to use when: `pan_tilt_recording.read_pan_tilt_reference` for a recording. It reads the moves
from the commands (`unit_moves`, `motion_profile`), fits their start times to the polled counts
(`move_fit`, `poll_likelihood`, `move_equations`), and gives a `pan_tilt_reference` or, if the
commands do not explain the counts, a `counted_reference`.
"""
