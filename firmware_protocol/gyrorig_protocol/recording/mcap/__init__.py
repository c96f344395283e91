"""MCAP files at the level of records: scan, unpack, and build files that can be damaged.

What to use when: only inside `gyrorig_protocol.recording`, except `losses` (the losses of a
recording) and `disk_file` (the disk interface of a writer).
"""
