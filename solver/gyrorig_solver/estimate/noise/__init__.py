"""The noise of the samples: density, levels, whitening and outliers.

What to use when: `noise_model` for the density and its levels; `noise_estimation` for the
periodograms they are fitted to; `whitening` for derivatives in units of the noise; `outliers` and
`impulse_response_mask` for samples to reject.
"""
