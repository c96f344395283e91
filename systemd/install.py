"""Put the daemon under /opt and its files in their places: `sudo make install-service`.

What to use when: on a Raspberry Pi or any Debian, as root, as often as wanted: what is
there already is left, and every line says what was done. `--root DIR` does it into an image
or an empty folder. Only the standard library: it runs before anything is installed.

Theory of operation. Each file that is written is noted in PREFIX/installed.json with its
digest. A file that differs from its note was changed by a person: it stays, and the new one
is put beside it as FILE.new. The rig's configuration is never replaced.
"""

# ruff: noqa: S603, S607, T201 - root's own program: it prints what it does, and has root's PATH
import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
FILES = CHECKOUT / "systemd"
PREFIX = Path("/opt/gyrorig")
CONFIG = Path("/etc/gyrorig")
NOTES = "installed.json"
PYTHON = Path("/usr/bin/python3")  # of the system: one in a home does not start for the service
FOLDERS = {
    "system": Path("/etc/systemd/system"),
    "udev": Path("/etc/udev/rules.d"),
    "sysusers.d": Path("/etc/sysusers.d"),
    "tmpfiles.d": Path("/etc/tmpfiles.d"),
}
CAN_FOLDERS = {"network": Path("/etc/systemd/network"), "sysctl.d": Path("/etc/sysctl.d")}
SOURCES = ("pyproject.toml", "constraints.txt", "README.md", "LICENSE")
PACKAGES = ("daemon", "solver", "firmware_protocol")
DATA = ("config", "share")  # what the wheel carries beside the packages
COMMANDS = ("gyrorigd", "gyrorig")
SERVICE, TIMER = "gyrorigd.service", "gyrorig-nightly.timer"


class CannotInstallError(Exception):
    """Something is missing; the text says what to do."""


@dataclass(slots=True)
class Place:
    """Where things go, and what was written before."""

    root: Path
    done: int = 0
    notes: dict[str, str] = field(default_factory=dict)

    def path(self, name: Path) -> Path:
        """Return where `name`, an absolute path, is under the root."""
        return self.root / name.relative_to("/")

    @property
    def is_this_computer(self) -> bool:
        """True where services and devices are those of the running system."""
        return self.root == Path("/")

    def read_notes(self) -> None:
        """Recall what an earlier run has written."""
        try:
            self.notes = json.loads(self.path(PREFIX / NOTES).read_text())
        except (OSError, ValueError):
            self.notes = {}

    def write_notes(self) -> None:
        """Keep what was written."""
        write(self.path(PREFIX / NOTES), json.dumps(self.notes, indent=1).encode() + b"\n")

    def say(self, what: str, changed: bool = True) -> None:
        """Print one thing that was done, or that was so already."""
        self.done += changed
        print(f"{'  did' if changed else '   is'}  {what}", flush=True)

    def put(self, name: Path, content: bytes) -> bool:
        """Write a file unless it is so, or a person has changed it; True where written."""
        there = self.path(name)
        if there.exists():
            held = there.read_bytes()
            if held == content:
                self.notes[str(name)] = digest(content)
                self.say(f"{name}", changed=False)
                return False
            if digest(held) != self.notes.get(str(name)):
                beside = there.with_name(there.name + ".new")
                if beside.exists() and beside.read_bytes() == content:
                    self.say(f"{name}, with your changes; ours is in {name}.new", changed=False)
                    return False
                write(beside, content)
                self.say(f"{name} has your changes and stays; ours is in {name}.new: compare them")
                return False
        write(there, content)
        self.notes[str(name)] = digest(content)
        self.say(f"wrote {name}")
        return True


def digest(content: bytes) -> str:
    """Return what tells one content from another."""
    return hashlib.sha256(content).hexdigest()


def write(path: Path, content: bytes) -> None:
    """Write a file in one step, readable by all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_bytes(content)
    beside.chmod(0o644)
    beside.replace(path)


def run(*command: str | Path, env: dict[str, str] | None = None) -> None:
    """Run a program that has to succeed.

    Raises:
        CannotInstallError: it did not; its last words are in the text.
    """
    ended = subprocess.run(
        [str(word) for word in command],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, env=env,
    )  # fmt: skip
    if ended.returncode != 0:
        words = " ".join(str(word) for word in command[:3])
        raise CannotInstallError(f"{words} failed: {ended.stdout.strip()[-600:]}")


def install_programs(place: Place, python: Path, wheels: Path | None) -> None:
    """Make or renew the virtual environment with the programs.

    Raises:
        CannotInstallError: no suitable Python, or a package cannot be had.
    """
    prefix = place.path(PREFIX)
    state = sources_digest(python)
    mark = prefix / "sources.sha256"
    if mark.exists() and mark.read_text() == state:
        place.say(f"{PREFIX}: the programs of this checkout", changed=False)
        return
    check_python(python)
    fresh, old = prefix.with_name(prefix.name + ".new"), prefix.with_name(prefix.name + ".old")
    shutil.rmtree(old, ignore_errors=True)
    run(python, "-m", "venv", "--clear", fresh)
    fill(fresh, wheels)
    for script in (fresh / "bin").iterdir():  # they name the place where they were made
        if script.is_file() and not script.is_symlink():  # a package may leave a folder there
            text = script.read_bytes()
            script.write_bytes(text.replace(str(fresh).encode(), str(PREFIX).encode()))
    (fresh / mark.name).write_text(state)
    if (prefix / NOTES).exists():
        shutil.copy(prefix / NOTES, fresh / NOTES)
    # What runs keeps its files, and a failure up to here has changed nothing.
    if prefix.exists():
        prefix.rename(old)
    fresh.rename(prefix)
    shutil.rmtree(old, ignore_errors=True)
    place.say(f"{PREFIX}: a virtual environment of {python} with gyrorig and what it needs")


def fill(fresh: Path, wheels: Path | None) -> None:
    """Install gyrorig and what it needs into a new virtual environment."""
    offline = ["--no-index", "--find-links", str(wheels)] if wheels else []
    with tempfile.TemporaryDirectory() as copied:  # a build writes beside what it builds
        source = Path(copied)
        for name in SOURCES:
            shutil.copy(CHECKOUT / name, source / name)
        for name in (*PACKAGES, *DATA):
            passed_over = shutil.ignore_patterns("__pycache__", "*.mcap")
            shutil.copytree(CHECKOUT / name, source / name, ignore=passed_over)
        run(
            fresh / "bin" / "python", "-m", "pip", "install", "--disable-pip-version-check",
            "--no-cache-dir", *offline, "-c", CHECKOUT / "constraints.txt",
            f"{source}[solver,fleet]",
        )  # fmt: skip


def check_python(python: Path) -> None:
    """Make sure that the interpreter will start for the service's user too.

    Raises:
        CannotInstallError: it will not.
    """
    if not python.exists():
        raise CannotInstallError(f"no {python}: apt install python3 python3-venv, or --python")
    told = subprocess.run(
        [python, "-c", "import sys, venv, ensurepip; print(sys.version_info >= (3, 11))"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if told.returncode != 0:
        raise CannotInstallError(
            f"{python} makes no virtual environments: apt install python3-venv"
        )
    if told.stdout.strip() != "True":
        raise CannotInstallError(f"{python} is older than 3.11: name a newer one with --python")
    real = python.resolve()
    if real.is_relative_to("/root") or real.is_relative_to("/home"):
        raise CannotInstallError(
            f"{real} is in somebody's home, where the service's user cannot reach it: --python"
        )


def sources_digest(python: Path) -> str:
    """Return what tells one state of the checkout, and of the interpreter, from another."""
    told = hashlib.sha256(str(python).encode())
    paths = [CHECKOUT / name for name in SOURCES]
    for package in PACKAGES:
        paths += sorted((CHECKOUT / package).rglob("*.py"))
    for folder in DATA:
        paths += sorted(path for path in (CHECKOUT / folder).rglob("*") if path.is_file())
    for path in paths:
        told.update(str(path.relative_to(CHECKOUT)).encode() + path.read_bytes())
    return told.hexdigest()


def files(can_bus: bool) -> Iterator[tuple[Path, bytes]]:
    """Return every file and where it goes."""
    folders = FOLDERS | (CAN_FOLDERS if can_bus else {})
    for folder, target in folders.items():
        for path in sorted((FILES / folder).iterdir()):
            yield target / path.name, path.read_bytes()


def put_files(place: Place, can_bus: bool) -> None:
    """Write units, rules, user and folders; the configuration only where there is none."""
    for name, content in files(can_bus):
        place.put(name, content)
    for path in sorted((CHECKOUT / "config" / "programs").glob("*.yaml")):
        place.put(CONFIG / "programs" / path.name, path.read_bytes())
    for command in COMMANDS:
        link = place.path(Path("/usr/local/bin") / command)
        if link.is_symlink() and link.readlink() == PREFIX / "bin" / command:
            place.say(f"/usr/local/bin/{command}", changed=False)
        elif link.exists() or link.is_symlink():
            place.say(f"/usr/local/bin/{command} is another program and stays", changed=False)
        else:
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(PREFIX / "bin" / command)
            place.say(f"/usr/local/bin/{command} -> {PREFIX}/bin/{command}")


def put_config(place: Place) -> bool:
    """Write a configuration to begin with; True where it still has to be edited."""
    name = CONFIG / "rig.yaml"
    if place.path(name).exists():
        place.say(f"{name}, which is yours", changed=False)
        return False
    write(place.path(name), (CHECKOUT / "config" / "rig-raspberrypi.yaml").read_bytes())
    place.say(f"wrote {name}: an example")
    return True


def make_users(place: Place) -> None:
    """Make the service's user and folders."""
    for tool, arguments in (
        ("systemd-sysusers", ["gyrorig.conf"]),
        ("systemd-tmpfiles", ["--create", "gyrorig.conf"]),
    ):
        if shutil.which(tool) is None:
            raise CannotInstallError(f"no {tool} here: this needs a system with systemd")
        run(tool, *([] if place.is_this_computer else [f"--root={place.root}"]), *arguments)
    place.say("user gyrorig in the group dialout; /var/lib/gyrorig", changed=False)


def enable(place: Place, has_to_be_edited: bool) -> None:
    """Let the daemon and the nightly run start with the computer, and now where that is safe."""
    offline = [] if place.is_this_computer else [f"--root={place.root}"]
    if shutil.which("systemctl") is None:
        raise CannotInstallError("no systemctl here: this needs a system with systemd")
    run("systemctl", *offline, "enable", SERVICE, TIMER)
    place.say(f"{SERVICE} and {TIMER} start with the computer", changed=False)
    if not place.is_this_computer or not Path("/run/systemd/system").is_dir():
        return
    run("systemctl", "daemon-reload")
    run("systemctl", "start", TIMER)
    if has_to_be_edited:
        return
    run("systemctl", "restart", SERVICE)
    place.say(f"restarted {SERVICE}: it halts the unit first")


def tell_udev(place: Place) -> None:
    """Put the rules in force for what is plugged in."""
    if not place.is_this_computer or shutil.which("udevadm") is None:
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
    place.say("udev: names, latency timers and ModemManager's exceptions are in force")


def bring_up_can(place: Place) -> None:
    """Let systemd-networkd set can0 up, and give its reader room."""
    offline = [] if place.is_this_computer else [f"--root={place.root}"]
    run("systemctl", *offline, "enable", "systemd-networkd.service")
    if place.is_this_computer and Path("/run/systemd/system").is_dir():
        run("systemctl", "restart", "systemd-networkd.service")
        run("sysctl", "--quiet", "--load", CAN_FOLDERS["sysctl.d"] / "80-gyrorig.conf")
    place.say("systemd-networkd sets can0 up; other networks are left alone", changed=False)


def remove(place: Place) -> None:
    """Take away what was installed; recordings, calibrations and the configuration stay."""
    place.read_notes()
    offline = [] if place.is_this_computer else [f"--root={place.root}"]
    if place.is_this_computer and Path("/run/systemd/system").is_dir():
        subprocess.run(["systemctl", "stop", SERVICE, TIMER], check=False)
    if shutil.which("systemctl") is not None:
        subprocess.run(["systemctl", *offline, "disable", SERVICE, TIMER], check=False)
    for name, sha256 in place.notes.items():
        path = place.path(Path(name))
        if path.exists() and digest(path.read_bytes()) == sha256:
            path.unlink()
            place.say(f"removed {name}")
        elif path.exists():
            place.say(f"{name} has your changes and stays", changed=False)
    for command in COMMANDS:
        link = place.path(Path("/usr/local/bin") / command)
        if link.is_symlink() and link.readlink() == PREFIX / "bin" / command:
            link.unlink()
            place.say(f"removed /usr/local/bin/{command}")
    shutil.rmtree(place.path(PREFIX), ignore_errors=True)
    place.say(f"removed {PREFIX}; {CONFIG} and /var/lib/gyrorig stay")


def main(arguments: Sequence[str] | None = None) -> int:
    """Install, or remove; returns the exit code."""
    parser = argparse.ArgumentParser(prog="install-service", description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, default=Path("/"), help="into an image or a folder")
    parser.add_argument("--python", type=Path, default=PYTHON, help="the system's interpreter")
    parser.add_argument("--wheels", type=Path, help="packages from this folder, not the network")
    parser.add_argument("--only-files", action="store_true", help="the programs are there already")
    parser.add_argument("--can", action="store_true", help="set up can0, by systemd-networkd")
    parser.add_argument("--remove", action="store_true", help="take it away again")
    options = parser.parse_args(arguments)
    place = Place(options.root.absolute())
    try:
        if os.geteuid() != 0:
            raise CannotInstallError("it needs root: sudo make install-service")
        if options.remove:
            remove(place)
            return 0
        place.read_notes()
        if not options.only_files:
            install_programs(place, options.python, options.wheels)
        put_files(place, options.can)
        has_to_be_edited = put_config(place)
        make_users(place)
        place.write_notes()
        tell_udev(place)
        if options.can:
            bring_up_can(place)
        enable(place, has_to_be_edited)
    except (CannotInstallError, OSError) as fault:
        print(f"install-service: {fault}", file=sys.stderr)
        return 1
    print("nothing had to be done" if not place.done else f"{place.done} things done")
    if has_to_be_edited:
        print(
            f"\nNow edit {CONFIG}/rig.yaml: ports are in /dev/gyrorig and /dev/serial/by-id. Then\n"
            f"  gyrorigd doctor --config {CONFIG}/rig.yaml\n  systemctl start {SERVICE}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
