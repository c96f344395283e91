"""What to do about lost samples, by the way on which they arrived."""

_REMEDIES = {
    "can": (
        "lower the board's output rate, raise the bit rate of the bus, or reduce the load of the "
        "host"
    ),
    "file": (
        "record again with a lower output rate or with a faster recorder, or ask the person who "
        "recorded the file for the missing samples"
    ),
}
_SERIAL_REMEDY = (
    "lower the board's output rate, raise the baud rate, or reduce the load of the host"
)


def lost_samples_remedy(link: str) -> str:
    """Return what to do if samples were lost, without a full stop at its end.

    Args:
        link: the key `link` of the board's metadata. An unknown link is a serial line, as in
            recordings without this key.
    """
    return _REMEDIES.get(link, _SERIAL_REMEDY)
