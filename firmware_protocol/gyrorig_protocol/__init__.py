"""Every format that crosses a boundary of the rig.

What to use when:

- `gyrorig_protocol.ptu`: the pan-tilt unit's ASCII language, bytes in, events out.
- `gyrorig_protocol.board`: a board's serial frames and text lines, bytes in, events out.
- `gyrorig_protocol.recording`: recordings of format 1, the only part that touches files.
- `gyrorig_protocol.program`: motion programs as data.
- `gyrorig_protocol.profile`: sensor profiles as data.
- `gyrorig_protocol.documents`: hostile YAML in, checked values out; plain YAML out.
- `gyrorig_protocol.errors`: the one tree of errors, by who must act.
"""
