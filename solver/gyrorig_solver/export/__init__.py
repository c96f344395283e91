"""A calibration in the words of other programs: C, ROS, Kalibr, PX4, ArduPilot, JSON.

What to use when: `formats.exported` for the text of one format; `FORMATS` lists them. Each
module writes one of them and says in the file itself which frame, which direction, which
order and which unit its numbers have. What a format has no place for is said there too.
"""
