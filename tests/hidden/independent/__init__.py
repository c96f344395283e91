"""A second truth for the scores of naming: sessions from assumptions that no other part shares.

`parts` draws a rig, `simulation` integrates its motion on a grid of 4 kHz and samples it, `causes`
hides causes of the catalogue, and `effects` has effects that are in no catalogue. `visibility`
measures how visible a difference is, `sizing` sets its size, `draws` decides what a seed hides,
`answer` states it, and `make` is the program. The layout of a corpus is that of
`tests.hidden.truth.make`.
"""
