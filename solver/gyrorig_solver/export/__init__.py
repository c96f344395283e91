"""Exports of a calibration to other programs: C, ROS, Kalibr, PX4, ArduPilot, JSON.

What to use when: `export_formats.export_text` for the text in one format; `FORMATS` lists the
formats. Each module writes one or two of them. Every exported file states the frame, direction,
order and unit of its numbers, and lists what the format has no place for.
"""
