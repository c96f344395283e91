"""What a gyroscope on a pan-tilt unit may do beyond the base model, one file a cause.

What to use when: `catalogue` finds every cause by its id; `scene.Scene` is what a cause may
look at; `protocol` says what every cause offers; `bases` holds the few ways to be one. A
new cause is a new file here with a `TERM`, and its tests.
"""
