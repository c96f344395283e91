"""Open a serial port exclusively, in raw mode, with low latency.

It is locked twice. TIOCEXCL keeps out every opener but root; flock keeps out programs that
ask for it (`exclusive` of pyserial), root included. A pseudo-terminal gets the flock only:
its TIOCEXCL stays set while the other end is open, and would keep out the next user. It uses
only the standard library, because the acquisition process imports it.
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
# errors of USB drivers for an adapter that hangs or is being unplugged
_BROKEN = (errno.EIO, errno.EPIPE, errno.EPROTO, errno.ESHUTDOWN, errno.ETIMEDOUT)


class PortRefusedError(Exception):
    """A port could not be opened; `reason` is missing, busy, denied, broken or foreign.

    Broken: the device is there and does not answer its driver; it may recover, or be plugged in
    again. Foreign: the path is not a port of this kind and never will be.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


def open_port(path: str, baud: int) -> int:
    """Return the file descriptor of the port at `path`, raw, non-blocking and locked.

    Raises:
        PortRefusedError: it does not exist, is not a terminal, is not permitted, or is in use.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as fault:
        raise PortRefusedError(_reason(fault), os.strerror(fault.errno or 0)) from fault
    try:
        if not os.isatty(fd):
            raise PortRefusedError("foreign", "it is not a serial port")
        _lock_exclusively(fd)
        configure_raw(fd, baud)
        _set_low_latency(fd)
    except BlockingIOError as fault:
        os.close(fd)
        raise PortRefusedError("busy", "another program uses it") from fault
    except (OSError, termios.error) as fault:
        os.close(fd)
        number = fault.args[0] if fault.args else 0  # termios.error has no errno
        reason = "broken" if number in _BROKEN else "foreign"
        raise PortRefusedError(reason, f"it cannot be configured ({fault})") from fault
    except PortRefusedError:
        os.close(fd)
        raise
    return fd


def _lock_exclusively(fd: int) -> None:
    """Keep other programs out.

    Raises:
        BlockingIOError: another program has the port.
    """
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    exclusive = bytearray(4)
    with contextlib.suppress(OSError):  # unknown before Linux 3.8
        fcntl.ioctl(fd, _TIOCGEXCL, exclusive)
    if any(exclusive):  # the kernel does not enforce it for root
        raise BlockingIOError(errno.EAGAIN, "another program has opened it exclusively")
    if os.major(os.fstat(fd).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def configure_raw(fd: int, baud: int) -> None:
    """Set 8N1 without any processing, and discard what was received before.

    Raises:
        PortRefusedError: the port does not support this baud rate.
        termios.error: the descriptor is not a terminal.
    """
    speed_constant = getattr(termios, f"B{baud}", None)
    speed = termios.B38400 if speed_constant is None else speed_constant
    settings = termios.tcgetattr(fd)
    settings[0] = 0  # iflag: no translation of CR, LF, XON, parity marks
    settings[1] = 0  # oflag
    settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL  # cflag: 8N1, no modem lines
    settings[3] = 0  # lflag: no echo, no line editing, no signals
    settings[4] = settings[5] = speed
    settings[6][termios.VMIN] = 0
    settings[6][termios.VTIME] = 0
    termios.tcsetattr(fd, termios.TCSANOW, settings)
    if speed_constant is None:
        _set_nonstandard_rate(fd, baud)
    termios.tcflush(fd, termios.TCIOFLUSH)


def list_serial_ports(limit: int = 8) -> list[str]:
    """Return the serial ports of this computer, stable names first."""
    paths: list[str] = []
    for folder, pattern in (
        ("/dev/serial/by-id", "*"),
        ("/dev", "ttyUSB*"),
        ("/dev", "ttyACM*"),
        ("/dev", "ttyAMA*"),
    ):
        with contextlib.suppress(OSError):
            paths += sorted(str(path) for path in Path(folder).glob(pattern))
    return paths[:limit]


def _set_nonstandard_rate(fd: int, baud: int) -> None:
    """Set a baud rate without a constant, such as 250000 of AVR boards."""
    buffer = bytearray(_TERMIOS2.size)
    try:
        fcntl.ioctl(fd, _TCGETS2, buffer)
        iflag, oflag, cflag, lflag, control_bytes, _, _ = _TERMIOS2.unpack(buffer)
        cflag = (cflag & ~_CBAUD) | _BOTHER
        fcntl.ioctl(
            fd, _TCSETS2, _TERMIOS2.pack(iflag, oflag, cflag, lflag, control_bytes, baud, baud)
        )
    except OSError as fault:
        raise PortRefusedError("foreign", f"it does not support {baud} baud") from fault


def _set_low_latency(fd: int) -> None:
    """Ask the driver not to collect bytes; drivers without this setting are left alone."""
    with contextlib.suppress(OSError):
        buffer = bytearray(_SERIAL_STRUCT_BYTES)
        fcntl.ioctl(fd, _TIOCGSERIAL, buffer)
        (flags,) = struct.unpack_from("=i", buffer, _FLAGS_AT)
        struct.pack_into("=i", buffer, _FLAGS_AT, flags | _ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, _TIOCSSERIAL, bytes(buffer))


def _reason(fault: OSError) -> str:
    if fault.errno in (errno.EBUSY, errno.EAGAIN):
        return "busy"
    if fault.errno in (errno.EACCES, errno.EPERM):
        return "denied"
    if fault.errno in _BROKEN:
        return "broken"
    return "missing" if fault.errno in (errno.ENOENT, errno.ENXIO, errno.ENODEV) else "foreign"
