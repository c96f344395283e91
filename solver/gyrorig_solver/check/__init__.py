"""Checks of a recording, and comparison of results with the truth of an emulated rig.

What to use when: `recording_health.examine_recording` for the content and the defects of a
recording and for the parameters that its motion makes observable;
`health_messages.health_verdict` and `health_messages.health_problems` for the same as text;
`true_values` and `injected_causes` to compare results with an emulated rig.
"""
