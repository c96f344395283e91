"""The linear algebra of a fit: whitened derivatives, normal equations and packed columns.

What to use when: `whitening` for derivatives in units of the noise; `normal_equations` to add up
the parts of a recording; `packed_columns` for derivatives that are zero outside a short interval.
"""
