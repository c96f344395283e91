"""Exports of a calibration to other programs: C, ROS, Kalibr, PX4, ArduPilot, JSON.

What to use when: `export_formats.export_text` for the text in one format; `FORMATS` lists the
formats. Each module writes one or two of them. Every exported file states the frame, direction,
order and unit of its numbers, and lists the causes that the format cannot contain.
"""

from gyrorig_solver.export.export_formats import FORMATS, ExportOptions, export_text
from gyrorig_solver.export.export_source import ExportSource

__all__ = [
    "FORMATS",
    "ExportOptions",
    "ExportSource",
    "export_text",
]
