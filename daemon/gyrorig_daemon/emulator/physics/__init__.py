"""The physics of an emulated rig: what really happens, whatever is said on the wire.

What to use when: `motion_law`, `train` and `axis` for a stepper axis (counted steps apart
from the true angle); `stage` for the body rate and gravity of the platform; `lowpass`,
`noise`, `temperature` and `imu` for what a sensor makes of them; `effects` for what else may
be wrong with any of it; `clock` for every counter that is not the host's; `latency` for when
bytes reach the host's hands.
"""
