"""The physics of an emulated rig: what really happens, whatever is said on the wire.

What to use when: `motion_law` and `axis` for a stepper axis (counted steps apart from the
true angle); `stage` for the body rate and gravity of the platform; `lowpass`, `noise`,
`gyro` and `accelerometer` for what a sensor makes of them; `clock` for every counter that
is not the host's; `latency` for when bytes reach the host's hands.
"""
