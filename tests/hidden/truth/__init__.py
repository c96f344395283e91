"""Sessions of the emulated rig with hidden effects, for the scores of the search for causes.

This package uses the emulator and does not use the solver. The visibility of the noise-free
difference sets the size of an effect. `make` is the program. `draws` draws the session of a seed,
`sizing` finds the sizes, `outside` contains effects outside the catalogue, `session` records, and
`answer` makes the sealed answer.
"""
