"""Errors for ports that cannot be opened. It imports little: `gyrorigd halt` must start quickly."""

from gyrorig_daemon.links.ports.serial_port import list_serial_ports
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError, MachineError, UsageError


def port_error(port: str, path: str, reason: str, text: str) -> GyrorigError:
    """Return the error for a port that could not be opened; its class says who must act."""
    if reason == "busy":
        return BusyError(
            f"the port {path} ({port}) is busy: {text}",
            "end the program that uses the port (`gyrorigd doctor` names it), or wait until "
            "it has ended",
        )
    if reason == "denied":
        return MachineError(
            f"the user has no permission to open the port {path} ({port}): {text}",
            "run `sudo usermod -aG dialout $USER`, and log in again. `gyrorigd doctor` "
            "names the group of the port",
        )
    if reason == "broken":
        return DeviceError(
            f"the adapter of the port {path} ({port}) does not answer its driver: {text}",
            "unplug the adapter and plug it in again",
        )
    serial_ports = list_serial_ports()
    if serial_ports:
        hint = f"The serial ports of this computer are {', '.join(serial_ports)}"
    else:
        hint = "This computer has no serial port at present"
    if reason == "missing":
        return DeviceError(
            f"the port {path} ({port}) does not exist ({text})",
            f"check the cable of the device. {hint}",
        )
    return UsageError(
        f"the port {path} ({port}) cannot be used: {text}",
        f"correct the port in the rig file. {hint}",
    )
