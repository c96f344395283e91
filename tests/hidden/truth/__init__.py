"""The truth side of the tests that hide an effect: what is hidden, how large, in what rig.

It knows the emulator and nothing of the solver: an effect's size is set by how visible its
own noise-free difference is. `make` is the program; `draws` what one seed decides, `sizing`
how large, `outside` effects that are in no catalogue, `session` the recording, `answer` what
is sealed.
"""
