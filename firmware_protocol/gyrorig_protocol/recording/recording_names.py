"""Names of several recordings in texts and documents.

What to use when: `distinct_names` wherever a text or a key names one of several recordings.
"""

from collections import Counter
from collections.abc import Sequence

from gyrorig_protocol.recording.recording import Recording


def distinct_names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the file name of each recording, with as many folders as equal names need."""
    parts = [recording.path.absolute().parts for recording in recordings]
    depths = [1] * len(parts)
    while True:
        names = tuple("/".join(p[-depth:]) for p, depth in zip(parts, depths, strict=True))
        counts = Counter(names)
        short = [
            k for k, name in enumerate(names) if counts[name] > 1 and depths[k] < len(parts[k]) - 1
        ]
        if not short:
            return names
        for k in short:
            depths[k] += 1
