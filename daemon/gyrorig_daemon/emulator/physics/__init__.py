"""Physics of the emulated rig: the true motion and the true signals.

What to use when: `motion_law`, `step_train` and `stepper_axis` for a stepper axis, whose counted
steps differ from its true angle; `stage_motion` for the body rate and gravity on the platform;
`lowpass`, `bias_noise`, `temperature` and `imu` for a sensor; `effects` for the interfaces of
further errors; `device_clock` for the clocks of devices; `host_latency` for the arrival times at
the host.
"""
