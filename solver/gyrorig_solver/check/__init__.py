"""Is a recording sound, and what can it calibrate?

What to use when: `health.examine` for what is in a recording and what is wrong with it, and
`remarks.verdict` and `remarks.problems` for the same in words;
`capability.capability` for which parameters its motion can show, without a fit.
"""
