"""Ports and what reads them: the seam of time, and the process behind it in real time."""
