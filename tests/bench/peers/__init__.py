"""Other methods that calibrate a gyroscope, for a comparison on the same recordings.

`recording` makes the data of all methods. `methods` and `factor_graph` contain the peers for a
pan-tilt unit. `turns` simulates a session for imucal. `measured` uses recordings of others, and
`figures` makes the tables. The bench compares a peer only in the parameters that it estimates.
"""
