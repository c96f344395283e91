"""Reference motions: what the rates of a sensor are compared with.

What to use when: `reference_motion.ReferenceMotion` is the interface that the estimator uses.
`unit` reconstructs the motion of a pan-tilt unit; `attitude_reference` uses measured attitudes,
`known_turns` turns by known angles, `gravity_reference` gravity between rests, and
`rest_reference` a board at rest. `rotations` has the rotation algebra.
"""
