"""The noise of the samples: density, levels and outliers.

What to use when: `noise_model` for the density and its levels; `noise_estimation` for the
periodograms to which they are fitted; `outliers` and `impulse_response_mask` for samples to reject.
"""
