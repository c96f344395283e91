"""Builds the Debian package: `make deb` writes dist/gyrorig_VERSION_ARCHITECTURE.deb.

What to use when: on the Debian release and the architecture that the package is for. Root is not
needed. `systemd/install.py` installs the same files without a package.

Theory of operation. The package contains /opt/gyrorig, a virtual environment of the system's
Python with the packages of constraints.txt. Therefore the package depends on the minor version of
this Python. The scripts in `release/debian` run when the package is installed and removed.
"""

# ruff: noqa: S603 - the system's programs
import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(CHECKOUT / "systemd"))

import install  # noqa: E402
from locked_install import CannotInstallError, run  # noqa: E402

SCRIPTS = CHECKOUT / "release" / "debian"
DOCUMENTS = Path("/usr/share/doc/gyrorig")
# manylinux wheels use the C and C++ libraries of the system.
LIBRARIES = "libc6 (>= 2.28), libgcc-s1, libstdc++6"
CONTROL = """\
Package: gyrorig
Version: {version}
Architecture: {architecture}
Maintainer: {maintainer}
Depends: python3 (>= 3.{minor}), python3 (<< 3.{next_minor}), {libraries}, systemd, udev
Installed-Size: {size_kib}
Section: science
Priority: optional
Description: {description}
 The daemon gyrorigd moves a pan-tilt unit and records boards. The solver
 gyrorig computes calibrations from the recordings. The package contains both,
 with the Python packages that they need, under /opt/gyrorig.
"""


def build(python: Path, wheels: Path | None, out: Path) -> Path:
    """Build the package and return its path.

    Raises:
        CannotInstallError: a package cannot be installed, or a program failed.
    """
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]
    architecture = output("dpkg", "--print-architecture")
    minor = int(output(python, "-I", "-c", "import sys; print(sys.version_info.minor)"))
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "root"
        target = install.Target(root)
        target.path(install.PREFIX).parent.mkdir(parents=True)
        install.install_programs(target, python, wheels)
        for path, content in files():
            install.write(target.path(path), content)
        for link, to in links(target):
            target.path(link).parent.mkdir(parents=True, exist_ok=True)
            target.path(link).symlink_to(to)
        control = root / "DEBIAN"
        control.mkdir()
        size = sum(path.lstat().st_size for path in root.rglob("*") if not path.is_dir())
        text = CONTROL.format(
            version=project["version"], architecture=architecture, minor=minor,
            next_minor=minor + 1, libraries=LIBRARIES, size_kib=size // 1024,
            maintainer="The Gyrorig authors <gyrorig@localhost>",
            description=project["description"],
        )  # fmt: skip
        (control / "control").write_text(text, "utf-8")
        ours = [path for path, _ in files() if path.is_relative_to("/etc")]
        (control / "conffiles").write_text("".join(f"{path}\n" for path in ours))
        for script in SCRIPTS.iterdir():
            install.write(control / script.name, script.read_bytes())
            (control / script.name).chmod(0o755)
        out.mkdir(parents=True, exist_ok=True)
        package = out / f"gyrorig_{project['version']}_{architecture}.deb"
        root.chmod(0o755)
        run("dpkg-deb", "--root-owner-group", "-Zzstd", "-z3", "--build", root, package)
    return package


def files() -> Iterator[tuple[Path, bytes]]:
    """Yield the destination and the content of each file outside of /opt."""
    for path, content in install.files(can_bus=False):
        yield Path("/usr/lib") / path.relative_to("/etc"), content
    for folder in install.CAN_FOLDERS:
        for path in sorted((install.FILES / folder).iterdir()):
            yield DOCUMENTS / "examples" / path.name, path.read_bytes()
    example = CHECKOUT / "config" / "rig-raspberrypi.yaml"
    yield DOCUMENTS / "examples" / example.name, example.read_bytes()
    for path in sorted((CHECKOUT / "config" / "programs").glob("*.yaml")):
        yield install.CONFIG / "programs" / path.name, path.read_bytes()
    yield DOCUMENTS / "copyright", (CHECKOUT / "LICENSE").read_bytes()
    yield DOCUMENTS / "THIRD-PARTY.md", (CHECKOUT / "THIRD-PARTY.md").read_bytes()


def links(target: install.Target) -> Iterator[tuple[Path, Path]]:
    """Yield each link in /usr and the file in /opt that it leads to."""
    for command in install.COMMANDS:
        yield Path("/usr/bin") / command, install.PREFIX / "bin" / command
    share = target.path(install.PREFIX) / "share"
    for folder in ("man", "bash-completion", "zsh", "fish"):
        for path in sorted((share / folder).rglob("*")):
            if path.is_file() and "gyrorig" in path.name:
                name = path.relative_to(share)
                place = str(name).replace("zsh/site-functions", "zsh/vendor-completions")
                yield Path("/usr/share") / place, install.PREFIX / "share" / name


def output(*command: str | Path) -> str:
    """Return what a program prints."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Build the package; return the exit status."""
    parser = argparse.ArgumentParser(prog="deb", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=CHECKOUT / "dist", help="folder")
    parser.add_argument("--python", type=Path, default=install.PYTHON, help="the system's")
    parser.add_argument("--wheels", type=Path, help="take packages from this folder alone")
    options = parser.parse_args(arguments)
    os.umask(0o022)
    try:
        package = build(options.python, options.wheels, options.out)
    except (CannotInstallError, OSError, subprocess.CalledProcessError) as fault:
        print(f"deb: {fault}", file=sys.stderr)  # noqa: T201
        return 1
    print(f"{package} ({package.stat().st_size >> 20} MiB)")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
