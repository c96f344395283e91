"""Rigs with hidden causes, simulated independently of the solver and of the emulator.

`prior_sizes` draws causes, `serial_session` runs a program on a stepper unit, `stage_motion`
turns steps into angles and rates, `gyroscope` and `samples` make counts, `recording_file` writes
an MCAP recording. `rig` joins them; `trial` solves one recording, `coverage` judges many, and
`emulated_cases` has six recordings of the emulator.
"""
