"""The search for causes with reference attitudes.

What to use when: `explain_attitudes.explain_attitudes` for findings; `attitude_space` is the fit
that the search uses; `attitude_terms` contains the causes and smooth functions of this reference.
"""
