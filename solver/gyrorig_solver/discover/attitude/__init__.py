"""The search for causes with reference attitudes.

What to use when: `explain_attitudes.explain_attitudes` for findings; `attitude_space` is the fit
that the search works on, `attitude_terms` has the causes and smooth functions of this reference.
"""
