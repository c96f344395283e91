"""Imperfections of the emulated rig, a physical cause or a family of causes a file.

What to use when: `hooks` for where an effect hangs on a rig. Of an axis: `play`, `slip`,
`s_curve`, `ringing`, `compliance`, `angles`, behind the interfaces in `motor`. Of a board:
`mount`, `nonlinear`, `crosstalk`, `bias`, `words`, `timing`, behind those in `sensor`. Of the
world: `earth`. Names, sizes and directions are drawn in `causes`; here is the physics only.
"""
