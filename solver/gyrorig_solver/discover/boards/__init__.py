"""The search in several boards on one pan-tilt unit.

What to use when: `joint_explanation.explain_jointly`; `joint_projector` and `scope_hypotheses`
decide whether a cause belongs to the unit or to a board.
"""
