"""One session: a rig, a motion program, a recording.

What to use when: `record_modes` for a session as `gyrorigd record` runs it, in real or in
simulated time; `session.Session` on a `connected_rig.Rig` that is used again afterwards, as
the service does. Nothing is imported here, so that `gyrorigd halt` starts quickly.
"""
