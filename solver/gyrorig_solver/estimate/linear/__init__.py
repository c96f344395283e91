"""The normal equations of a fit, and the packed columns of its local unknowns.

What to use when: `normal_equations` to add up the parts of a recording; `packed_columns` for
derivatives that are zero outside a short interval.
"""
