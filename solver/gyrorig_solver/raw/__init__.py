"""What the raw stream of a board shows by itself, before any model is believed.

What to use when: `checks.look_at` for one board of one recording, `gain.look_at_gain` once
a gain is known. Each look says what it saw; a finding says what is wrong and what to do.
"""
