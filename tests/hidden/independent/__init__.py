"""A second simulator for the scores of naming, with assumptions that no other part shares.

`parts` draws a rig, `simulation` integrates its motion on a grid of 4 kHz and samples it, `causes`
hides causes of the catalogue, and `effects` contains effects outside the catalogue. `visibility`
measures the visibility of a difference, `sizing` finds its size, `draws` draws the session of a
seed, `answer` makes the answer, and `make` is the program. The layout of a corpus is that of
`tests.hidden.truth.make`.
"""
