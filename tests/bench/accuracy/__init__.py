"""A rig in memory for the statistics of the estimator; shares no code with the solver.

`profile` moves two axes by closed forms, `unit` makes a program and a line of them, `noise`
and `board` make counts, `bound` says what the best estimate could reach, `trial` puts one
run together, `figures` judges many.
"""
