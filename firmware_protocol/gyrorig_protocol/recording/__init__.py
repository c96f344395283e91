"""Recordings of format 1: the messages, the writer, the reader.

What to use when:

- `messages`, `standard_messages`: what goes into a recording, as frozen dataclasses.
- `writer.RecordingWriter`: write one file, safely.
- `reader.read_recording`: read one file, finished or not, whole or damaged.
- `recording.Recording`: what the reader returns; `recording.times_ns` for its stamps.
"""
