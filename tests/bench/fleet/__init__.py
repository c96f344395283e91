"""Synthetic fleets: `make` records one on the emulator, `synthetic_fleet` writes rows only.

What to use when: `make` where recordings are needed, a few hundred; `synthetic_fleet` where a
million calibrations are. Both draw boards and nights by `parts`.
"""
