"""Search for the causes of a base fit's residual.

What to use when: `fit_explanation.explain_fit` for one board, `boards.joint_explanation` for
several boards on one unit, `attitude.explain_attitudes` with reference attitudes. The search
itself is `cause_search`; `checks` has the tests of its result; `cause_findings` the result types.
"""
