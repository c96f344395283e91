"""Units that understand the commands of Directed Perception: FLIR PTU-E46, D46, D48 and D48E.

What to use when: `drivers.directed_perception` is the driver. `PtuClient` exchanges commands and
replies; `identify_unit` identifies and halts a unit; `set_up_unit` prepares it and reads its
capabilities before anything moves.
"""
