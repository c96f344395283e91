"""The noise of the samples: density, levels and outliers.

What to use when: `noise_model` for the density; `residual_spectrum` and `noise_estimation` for the
periodograms to which `noise_levels` fits it; `missing_samples` for recordings with gaps; `outliers`
and `impulse_response_mask` for samples to reject.
"""
