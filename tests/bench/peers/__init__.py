"""Other ways of calibrating a gyroscope, on the same recordings as ours.

`recording` makes what all are given, `methods` and `factor_graph` are the peers on a pan-tilt
unit, `turns` is imucal's kind of session, `measured` the recordings of others, `figures` the
tables. Each peer is judged on what it estimates, and says what it cannot see.
"""
