"""Opening a serial port for one owner: raw, exclusive, quick.

Taken twice: TIOCEXCL keeps out every opener but root, flock keeps out those that ask
(pyserial's `exclusive`), root included. A pseudo-terminal gets the lock only: its
TIOCEXCL outlives whoever set it for as long as the other end is open, and then keeps
out its next user. Only the standard library: the acquisition process imports this.
"""

import contextlib
import errno
import fcntl
import os
import struct
import termios
from pathlib import Path

# <linux/serial.h> struct serial_struct begins: type, line (int), port (uint), irq, flags (int)
_SERIAL_STRUCT_BYTES = 72
_FLAGS_AT = 16
_ASYNC_LOW_LATENCY = 1 << 13
_TIOCGSERIAL = 0x541E
_TIOCSSERIAL = 0x541F
# <asm-generic/ioctls.h>, <asm-generic/termbits.h>: struct termios2 is four flag words, the
# line discipline, 19 control characters, and both speeds as numbers
_TCGETS2 = 0x802C542A
_TCSETS2 = 0x402C542B
_TIOCGEXCL = 0x80045440
_PTY_MAJORS = range(136, 144)  # Unix98 pseudo-terminals (kernel's devices.txt)
_BOTHER = 0o010000
_CBAUD = 0o010017
_TERMIOS2 = struct.Struct("=4I20sII")
# what USB drivers say of an adapter that hangs, or is just being pulled
_BROKEN = (errno.EIO, errno.EPIPE, errno.EPROTO, errno.ESHUTDOWN, errno.ETIMEDOUT)


class RefusedError(Exception):
    """A port could not be opened; `reason` is missing, busy, denied, broken or foreign.

    Broken is a device that is there and does not answer its driver; it may recover, or be
    plugged in again. Foreign is what will never be the port that is meant.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


def open_port(path: str, baud: int) -> int:
    """Return the descriptor of the port at `path`, raw, non-blocking and ours alone.

    Raises:
        RefusedError: it is not there, not a terminal, not permitted, or held by another.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as fault:
        raise RefusedError(_reason(fault), os.strerror(fault.errno or 0)) from fault
    try:
        if not os.isatty(fd):
            raise RefusedError("foreign", "it is no serial port")
        _take_for_ourselves(fd)
        make_raw(fd, baud)
        _make_quick(fd)
    except BlockingIOError as fault:
        os.close(fd)
        raise RefusedError("busy", "another program holds it") from fault
    except (OSError, termios.error) as fault:
        os.close(fd)
        number = fault.args[0] if fault.args else 0  # termios.error has no errno
        reason = "broken" if number in _BROKEN else "foreign"
        raise RefusedError(reason, f"it cannot be set up: {fault}") from fault
    except RefusedError:
        os.close(fd)
        raise
    return fd


def _take_for_ourselves(fd: int) -> None:
    """Keep other programs out.

    Raises:
        BlockingIOError: one of them was first.
    """
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    alone = bytearray(4)
    with contextlib.suppress(OSError):  # unknown before Linux 3.8
        fcntl.ioctl(fd, _TIOCGEXCL, alone)
    if any(alone):  # to root the kernel does not say so itself
        raise BlockingIOError(errno.EAGAIN, "another program holds it alone")
    if os.major(os.fstat(fd).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def make_raw(fd: int, baud: int) -> None:
    """Set 8N1 without any processing, and drop what was received before.

    Raises:
        RefusedError: this system cannot do that baud rate.
        termios.error: the descriptor is no terminal.
    """
    named = getattr(termios, f"B{baud}", None)
    speed = termios.B38400 if named is None else named
    settings = termios.tcgetattr(fd)
    settings[0] = 0  # iflag: no translation of CR, LF, XON, parity marks
    settings[1] = 0  # oflag
    settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL  # cflag: 8N1, no modem lines
    settings[3] = 0  # lflag: no echo, no line editing, no signals
    settings[4] = settings[5] = speed
    settings[6][termios.VMIN] = 0
    settings[6][termios.VTIME] = 0
    termios.tcsetattr(fd, termios.TCSANOW, settings)
    if named is None:
        _set_odd_rate(fd, baud)
    termios.tcflush(fd, termios.TCIOFLUSH)


def candidates(limit: int = 8) -> list[str]:
    """Return ports of this machine that a person may have meant, best names first."""
    found: list[str] = []
    for folder, pattern in (
        ("/dev/serial/by-id", "*"),
        ("/dev", "ttyUSB*"),
        ("/dev", "ttyACM*"),
        ("/dev", "ttyAMA*"),
    ):
        with contextlib.suppress(OSError):
            found += sorted(str(path) for path in Path(folder).glob(pattern))
    return found[:limit]


def _set_odd_rate(fd: int, baud: int) -> None:
    """Set a rate that has no name, such as 250000 of an AVR board."""
    held = bytearray(_TERMIOS2.size)
    try:
        fcntl.ioctl(fd, _TCGETS2, held)
        iflag, oflag, cflag, lflag, rest, _, _ = _TERMIOS2.unpack(held)
        cflag = (cflag & ~_CBAUD) | _BOTHER
        fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(iflag, oflag, cflag, lflag, rest, baud, baud))
    except OSError as fault:
        raise RefusedError("foreign", f"this port has no rate of {baud} baud") from fault


def _make_quick(fd: int) -> None:
    """Ask the driver not to gather bytes; drivers without the question are left alone."""
    with contextlib.suppress(OSError):
        held = bytearray(_SERIAL_STRUCT_BYTES)
        fcntl.ioctl(fd, _TIOCGSERIAL, held)
        (flags,) = struct.unpack_from("=i", held, _FLAGS_AT)
        struct.pack_into("=i", held, _FLAGS_AT, flags | _ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, _TIOCSSERIAL, bytes(held))


def _reason(fault: OSError) -> str:
    if fault.errno in (errno.EBUSY, errno.EAGAIN):
        return "busy"
    if fault.errno in (errno.EACCES, errno.EPERM):
        return "denied"
    if fault.errno in _BROKEN:
        return "broken"
    return "missing" if fault.errno in (errno.ENOENT, errno.ENXIO, errno.ENODEV) else "foreign"
