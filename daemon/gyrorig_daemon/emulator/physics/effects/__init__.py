"""Interfaces of the effects that causes have on the emulated rig.

What to use when: `rig_hooks` for where effects are attached; `axis_effects` for interfaces of an
axis, `board_effects` for those of a board. `harmonic` is an effect that several causes share. The
causes themselves, with their physics, are in `emulator.causes`.
"""
