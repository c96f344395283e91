"""The physical causes of error beyond the base model, one file per cause.

What to use when: `model.catalogue` finds every cause by its id; `model.term` defines what a cause
must provide. A new cause is a new file here with a `TERM`: see docs/how-to/new-cause.md.
"""
