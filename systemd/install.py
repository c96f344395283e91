"""Installer of the service: `sudo make install-service`.

What to use when: on a Raspberry Pi or any Debian, as root, any number of times. Files that are up
to date are kept, and each change is printed. `--root DIR` installs into an image or an empty
folder. It uses only the standard library, because it runs before anything is installed.

Theory of operation. The digest of each written file is stored in PREFIX/installed.json. A file with
another digest was changed by a person: it is kept, and the new version is written next to it as
FILE.new. The configuration of the rig is never replaced. `release/locked_install.py` installs the
packages and compares each with its digest in constraints.txt.
"""

# ruff: noqa: S603, S607, T201 - it runs as root with root's PATH, and prints each change
import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(CHECKOUT / "release"))

from locked_install import CannotInstallError, install_locked, run  # noqa: E402

FILES = CHECKOUT / "systemd"
PREFIX = Path("/opt/gyrorig")
CONFIG = Path("/etc/gyrorig")
DIGESTS_FILE = "installed.json"
PYTHON = Path("/usr/bin/python3")  # the service's user cannot use one in a home directory
FOLDERS = {
    "system": Path("/etc/systemd/system"),
    "udev": Path("/etc/udev/rules.d"),
    "sysusers.d": Path("/etc/sysusers.d"),
    "tmpfiles.d": Path("/etc/tmpfiles.d"),
}
CAN_FOLDERS = {"network": Path("/etc/systemd/network"), "sysctl.d": Path("/etc/sysctl.d")}
SOURCES = ("pyproject.toml", "constraints.txt", "README.md", "LICENSE", "THIRD-PARTY.md")
PACKAGES = ("daemon", "solver", "firmware_protocol")
DATA = ("config", "share")  # data files of the wheel
EXTRAS = ("solver", "fleet")
COMMANDS = ("gyrorigd", "gyrorig")
SERVICE, TIMER = "gyrorigd.service", "gyrorig-nightly.timer"


@dataclass(slots=True)
class Target:
    """The root of the installation, and the digests of the files that were written."""

    root: Path
    change_count: int = 0
    digests: dict[str, str] = field(default_factory=dict)

    def path(self, name: Path) -> Path:
        """Return where `name`, an absolute path, is below the root."""
        return self.root / name.relative_to("/")

    @property
    def is_this_computer(self) -> bool:
        """True if the root is that of the running system."""
        return self.root == Path("/")

    def load_digests(self) -> None:
        """Load the digests of an earlier installation."""
        try:
            self.digests = json.loads(self.path(PREFIX / DIGESTS_FILE).read_text())
        except (OSError, ValueError):
            self.digests = {}

    def store_digests(self) -> None:
        """Store the digests."""
        write(self.path(PREFIX / DIGESTS_FILE), json.dumps(self.digests, indent=1).encode() + b"\n")

    def report(self, text: str, changed: bool = True) -> None:
        """Print a change, or a state that needed none."""
        self.change_count += changed
        print(f"{'changed' if changed else '     ok'}  {text}", flush=True)

    def put(self, name: Path, content: bytes) -> bool:
        """Write a file, unless it is up to date or a person has changed it; True if written."""
        path = self.path(name)
        if path.exists():
            present = path.read_bytes()
            if present == content:
                self.digests[str(name)] = digest(content)
                self.report(f"{name}", changed=False)
                return False
            if digest(present) != self.digests.get(str(name)):
                new_path = path.with_name(path.name + ".new")
                if new_path.exists() and new_path.read_bytes() == content:
                    self.report(
                        f"{name} (with your changes; the new version is {name}.new)", changed=False
                    )
                    return False
                write(new_path, content)
                self.report(f"{name} has your changes and is kept. Compare it with {name}.new")
                return False
        write(path, content)
        self.digests[str(name)] = digest(content)
        self.report(f"wrote {name}")
        return True


def digest(content: bytes) -> str:
    """Return the SHA-256 digest of a file's content."""
    return hashlib.sha256(content).hexdigest()


def write(path: Path, content: bytes) -> None:
    """Write a file atomically, readable by everyone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_bytes(content)
    temporary.chmod(0o644)
    temporary.replace(path)


def install_programs(target: Target, python: Path, wheels: Path | None) -> None:
    """Create or renew the virtual environment with the programs.

    Raises:
        CannotInstallError: there is no suitable Python, or a package cannot be installed.
    """
    prefix = target.path(PREFIX)
    state = sources_digest(python)
    mark = prefix / "sources.sha256"
    if mark.exists() and mark.read_text() == state:
        target.report(f"{PREFIX}: the programs are those of this checkout", changed=False)
        return
    check_python(python)
    fresh, old = prefix.with_name(prefix.name + ".new"), prefix.with_name(prefix.name + ".old")
    shutil.rmtree(old, ignore_errors=True)
    run(python, "-I", "-m", "venv", "--clear", fresh)
    install_locked(fresh / "bin" / "python", EXTRAS, wheels=wheels)
    for script in (fresh / "bin").iterdir():  # they contain the path at which they were created
        if script.is_file() and not script.is_symlink():  # a package can leave a folder there
            text = script.read_bytes()
            script.write_bytes(text.replace(str(fresh).encode(), str(PREFIX).encode()))
    (fresh / mark.name).write_text(state)
    if (prefix / DIGESTS_FILE).exists():
        shutil.copy(prefix / DIGESTS_FILE, fresh / DIGESTS_FILE)
    # Running programs keep their files, and a failure up to here has changed nothing.
    if prefix.exists():
        prefix.rename(old)
    fresh.rename(prefix)
    shutil.rmtree(old, ignore_errors=True)
    target.report(f"{PREFIX}: a virtual environment of {python} with gyrorig and its dependencies")


def check_python(python: Path) -> None:
    """Check that the service's user can run the interpreter.

    Raises:
        CannotInstallError: it cannot.
    """
    if not python.exists():
        raise CannotInstallError(
            f"{python} does not exist. Run apt install python3 python3-venv, or use --python"
        )
    completed = subprocess.run(
        [python, "-I", "-c", "import sys, venv, ensurepip; print(sys.version_info >= (3, 11))"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if completed.returncode != 0:
        raise CannotInstallError(
            f"{python} cannot create virtual environments. Run apt install python3-venv"
        )
    if completed.stdout.strip() != "True":
        raise CannotInstallError(f"{python} is older than 3.11. Give a newer one with --python")
    real = python.resolve()
    if real.is_relative_to("/root") or real.is_relative_to("/home"):
        raise CannotInstallError(
            f"{real} is in a home directory, which the service's user cannot access. Use --python"
        )


def sources_digest(python: Path) -> str:
    """Return a digest of the checkout and the interpreter."""
    result = hashlib.sha256(str(python).encode())
    paths = [CHECKOUT / name for name in SOURCES]
    for package in PACKAGES:
        paths += sorted((CHECKOUT / package).rglob("*.py"))
    for folder in DATA:
        paths += sorted(path for path in (CHECKOUT / folder).rglob("*") if path.is_file())
    for path in paths:
        result.update(str(path.relative_to(CHECKOUT)).encode() + path.read_bytes())
    return result.hexdigest()


def files(can_bus: bool) -> Iterator[tuple[Path, bytes]]:
    """Yield each file's destination and content."""
    folders = FOLDERS | (CAN_FOLDERS if can_bus else {})
    for folder, destination in folders.items():
        for path in sorted((FILES / folder).iterdir()):
            yield destination / path.name, path.read_bytes()


def put_files(target: Target, can_bus: bool) -> None:
    """Write units, rules, user and folders, programs and links."""
    for name, content in files(can_bus):
        target.put(name, content)
    for path in sorted((CHECKOUT / "config" / "programs").glob("*.yaml")):
        target.put(CONFIG / "programs" / path.name, path.read_bytes())
    for command in COMMANDS:
        link = target.path(Path("/usr/local/bin") / command)
        if link.is_symlink() and link.readlink() == PREFIX / "bin" / command:
            target.report(f"/usr/local/bin/{command}", changed=False)
        elif link.exists() or link.is_symlink():
            target.report(f"/usr/local/bin/{command} is another program and is kept", changed=False)
        else:
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(PREFIX / "bin" / command)
            target.report(f"/usr/local/bin/{command} -> {PREFIX}/bin/{command}")


def put_config(target: Target) -> bool:
    """Write an example configuration if there is none; True if it must be edited."""
    name = CONFIG / "rig.yaml"
    if target.path(name).exists():
        target.report(f"{name} (your configuration)", changed=False)
        return False
    write(target.path(name), (CHECKOUT / "config" / "rig-raspberrypi.yaml").read_bytes())
    target.report(f"wrote {name}, an example")
    return True


def make_users(target: Target) -> None:
    """Create the service's user and folders."""
    for tool, arguments in (
        ("systemd-sysusers", ["gyrorig.conf"]),
        ("systemd-tmpfiles", ["--create", "gyrorig.conf"]),
    ):
        if shutil.which(tool) is None:
            raise CannotInstallError(f"{tool} is missing. Use a system with systemd")
        run(tool, *([] if target.is_this_computer else [f"--root={target.root}"]), *arguments)
    target.report("user gyrorig in the group dialout; /var/lib/gyrorig", changed=False)


def enable(target: Target, must_be_edited: bool) -> None:
    """Enable the service and the nightly run, and start them if that is safe."""
    offline = [] if target.is_this_computer else [f"--root={target.root}"]
    if shutil.which("systemctl") is None:
        raise CannotInstallError("systemctl is missing. Use a system with systemd")
    run("systemctl", *offline, "enable", SERVICE, TIMER)
    target.report(f"{SERVICE} and {TIMER} start with the computer", changed=False)
    if not target.is_this_computer or not Path("/run/systemd/system").is_dir():
        return
    run("systemctl", "daemon-reload")
    run("systemctl", "start", TIMER)
    if must_be_edited:
        return
    run("systemctl", "restart", SERVICE)
    target.report(f"restarted {SERVICE}, which halts the unit first")


def tell_udev(target: Target) -> None:
    """Apply the udev rules to the connected devices."""
    if not target.is_this_computer or shutil.which("udevadm") is None:
        return
    if not Path("/run/udev/control").exists():
        return
    run("udevadm", "control", "--reload")
    run(
        "udevadm",
        "trigger",
        "--action=add",
        "--subsystem-match=tty",
        "--subsystem-match=usb-serial",
    )
    target.report("applied the udev rules: names, latency timers, ModemManager exceptions")


def bring_up_can(target: Target) -> None:
    """Let systemd-networkd configure can0, and increase the receive buffer."""
    offline = [] if target.is_this_computer else [f"--root={target.root}"]
    run("systemctl", *offline, "enable", "systemd-networkd.service")
    if target.is_this_computer and Path("/run/systemd/system").is_dir():
        run("systemctl", "restart", "systemd-networkd.service")
        run("sysctl", "--quiet", "--load", CAN_FOLDERS["sysctl.d"] / "80-gyrorig.conf")
    target.report("systemd-networkd configures can0; other networks are not changed", changed=False)


def remove(target: Target) -> None:
    """Remove the installation; recordings, calibrations and the configuration are kept."""
    target.load_digests()
    offline = [] if target.is_this_computer else [f"--root={target.root}"]
    if target.is_this_computer and Path("/run/systemd/system").is_dir():
        subprocess.run(["systemctl", "stop", SERVICE, TIMER], check=False)
    if shutil.which("systemctl") is not None:
        subprocess.run(["systemctl", *offline, "disable", SERVICE, TIMER], check=False)
    for name, sha256 in target.digests.items():
        path = target.path(Path(name))
        if path.exists() and digest(path.read_bytes()) == sha256:
            path.unlink()
            target.report(f"removed {name}")
        elif path.exists():
            target.report(f"{name} has your changes and is kept", changed=False)
    for command in COMMANDS:
        link = target.path(Path("/usr/local/bin") / command)
        if link.is_symlink() and link.readlink() == PREFIX / "bin" / command:
            link.unlink()
            target.report(f"removed /usr/local/bin/{command}")
    shutil.rmtree(target.path(PREFIX), ignore_errors=True)
    target.report(f"removed {PREFIX}; {CONFIG} and /var/lib/gyrorig are kept")


def main(arguments: Sequence[str] | None = None) -> int:
    """Install or remove; return the exit status."""
    parser = argparse.ArgumentParser(prog="install-service", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--root", type=Path, default=Path("/"), help="install into an image or a folder"
    )
    parser.add_argument("--python", type=Path, default=PYTHON, help="the system's interpreter")
    parser.add_argument(
        "--wheels", type=Path, help="take packages from this folder, not from the network"
    )
    parser.add_argument(
        "--only-files", action="store_true", help="install only the files, not the programs"
    )
    parser.add_argument("--can", action="store_true", help="configure can0 with systemd-networkd")
    parser.add_argument("--remove", action="store_true", help="remove the installation")
    options = parser.parse_args(arguments)
    target = Target(options.root.absolute())
    try:
        if os.geteuid() != 0:
            raise CannotInstallError("root permission is needed. Run sudo make install-service")
        if options.remove:
            remove(target)
            return 0
        target.load_digests()
        if not options.only_files:
            install_programs(target, options.python, options.wheels)
        put_files(target, options.can)
        must_be_edited = put_config(target)
        make_users(target)
        target.store_digests()
        tell_udev(target)
        if options.can:
            bring_up_can(target)
        enable(target, must_be_edited)
    except (CannotInstallError, OSError) as fault:
        print(f"install-service: {fault}", file=sys.stderr)
        return 1
    print(f"{target.change_count} changes" if target.change_count else "No changes were needed.")
    if must_be_edited:
        print(
            f"\nEdit {CONFIG}/rig.yaml: ports are in /dev/gyrorig and /dev/serial/by-id. Then run\n"
            f"  gyrorigd doctor --config {CONFIG}/rig.yaml\n  systemctl start {SERVICE}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
