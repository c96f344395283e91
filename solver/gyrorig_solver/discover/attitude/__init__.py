"""The search for causes with reference attitudes.

What to use when: `explain_attitudes.explain_attitudes` for findings; the other modules have the
terms, the stepwise search, the dependence tests and the cross-validation.
"""
