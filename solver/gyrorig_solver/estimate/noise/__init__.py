"""The noise of the samples: density, levels and outliers.

What to use when: `noise_model` for the density and its levels; `noise_estimation` for the
periodograms they are fitted to; `outliers` and `impulse_response_mask` for samples to reject.
"""
