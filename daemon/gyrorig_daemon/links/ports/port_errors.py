"""Errors for ports that cannot be opened. It imports little: `gyrorigd halt` must start quickly."""

from gyrorig_daemon.links.ports.serial_port import list_serial_ports
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError, MachineError, UsageError


def port_error(port: str, path: str, reason: str, text: str) -> GyrorigError:
    """Return the error for a port that could not be opened; its class says who must act."""
    if reason == "busy":
        return BusyError(
            f"{path} ({port}) is busy: {text}",
            "end that program (`gyrorigd doctor` names it), or wait until it has ended",
        )
    if reason == "denied":
        return MachineError(
            f"there is no permission to open {path} ({port}): {text}",
            "run `sudo usermod -aG dialout $USER`, and log in again. `gyrorigd doctor` names the "
            "group",
        )
    if reason == "broken":
        return DeviceError(
            f"{path} ({port}) does not answer its driver: {text}", "plug the adapter in again"
        )
    serial_ports = list_serial_ports()
    if serial_ports:
        hint = f"Ports of this computer: {', '.join(serial_ports)}"
    else:
        hint = "This computer has no serial port at present"
    if reason == "missing":
        return DeviceError(f"{path} ({port}) is not there ({text})", f"check the cable. {hint}")
    return UsageError(
        f"{path} ({port}) cannot be used: {text}", f"correct the rig's configuration. {hint}"
    )
