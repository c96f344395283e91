"""Recordings of format 1: MCAP files with ROS 2 messages.

What to use when:

- `reader.read_recording`: read a file, finished or not, sound or damaged.
- `recording.Recording`: the result of the reader; `recording.times_ns` for its timestamps.
- `writer.RecordingWriter`: write a file that survives a crash.
- `messages`, `clock_messages`, `standard_messages`: the messages of a recording.
- `salvage.salvage`: make a finished recording of an unfinished one.
- `recording_copy.copy_with_topics`: copy a recording and add topics.
"""
