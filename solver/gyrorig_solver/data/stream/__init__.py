"""Checks of the raw stream of a board, without a model of the motion.

What to use when: `stream_checks.check_stream` for one board of one recording, and
`gain_checks.check_gain` after a fit. Every check has a summary; a finding states the problem and
the remedy.
"""
