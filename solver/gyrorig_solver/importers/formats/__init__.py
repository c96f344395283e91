"""The formats that `gyrorig import` reads, one file per format.

What to use when: `measurement_format.formats` finds every format by its name;
`measurement_format.MeasurementFormat` defines what a format must provide. A new format is a new
file here with a `FORMAT`: see docs/how-to/import.md.
"""
