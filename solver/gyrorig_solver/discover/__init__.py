"""Search for the causes of a base fit's residual.

What to use when: `fit_explanation.explain_fit` for one board, `boards.joint_explanation` for
several boards on one unit, `attitude.explain_attitudes` with reference attitudes. `fit_space` has
what differs between references; the search itself is `cause_search`; `checks` has the checks of its
result; `cause_findings` the result types.
"""
