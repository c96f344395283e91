"""The causes that an emulated rig can have, one class per file, and their base class in `cause`.

The package `injection` finds every class here: a new cause is a new file.
"""
