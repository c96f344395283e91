"""Installs gyrorig with exactly the packages of constraints.txt, each compared with its digest.

What to use when: `install_locked` in the Makefile (as a program), in `systemd/install.py` and in
`release/deb.py`. It uses only the standard library, because it runs before anything is installed.

Theory of operation. Each line of constraints.txt pins a version and the SHA-256 digests of the
wheels of this version. pip accepts digests in constraints since version 26. Therefore the pinned
pip first replaces the pip of the virtual environment, and then installs the dependencies. The
project itself is built as a wheel. The build tool and its dependencies have digests, too, and stay
outside of the environment; an isolated build by pip would take them without digests.
"""

# ruff: noqa: S603 - the programs are those of the virtual environment
import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

CHECKOUT = Path(__file__).resolve().parents[1]
CONSTRAINTS = "constraints.txt"
# Packages of the tests that exist only as source archives; setuptools builds them.
FROM_SOURCE = ("cobs", "flir-ptu")
SOURCE_BUILD = ("setuptools",)


class CannotInstallError(Exception):
    """The installation cannot continue; the text contains the remedy."""


def requirements(source: Path, extras: Sequence[str]) -> list[str]:
    """Return the requirements of the project with some extras.

    Raises:
        CannotInstallError: there is no such extra.
    """
    project = tomllib.loads((source / "pyproject.toml").read_text("utf-8"))["project"]
    optional = project["optional-dependencies"]
    result = list(project["dependencies"])
    for extra in extras:
        if extra not in optional:
            raise CannotInstallError(f"no extra {extra}. Choose one of {', '.join(optional)}")
        result += list(_expanded(project["name"], optional, extra))
    return list(dict.fromkeys(result))


def _expanded(name: str, optional: dict[str, list[str]], extra: str) -> Iterator[str]:
    """Yield the requirements of an extra, with those of the extras that it names."""
    for text in optional[extra]:
        inner = re.fullmatch(rf"{name}\[(.+)\]", text)
        if inner is None:
            yield text
            continue
        for named in inner[1].split(","):
            yield from _expanded(name, optional, named.strip())


def install_locked(
    python: Path,
    extras: Sequence[str],
    *,
    source: Path = CHECKOUT,
    editable: bool = False,
    wheels: Path | None = None,
    quiet: bool = True,
) -> None:
    """Install gyrorig and its dependencies into the virtual environment of an interpreter.

    Args:
        python: the interpreter of the virtual environment.
        extras: the extras of gyrorig.
        source: a checkout; the build writes nothing into it.
        editable: True if the modules are used from the checkout.
        wheels: a folder with all packages, used instead of the network.
        quiet: False to show what pip prints.

    Raises:
        CannotInstallError: a program failed; the text contains the end of its output.
    """
    offline = ["--no-index", "--find-links", str(wheels.absolute())] if wheels else []
    from_source = ["--no-binary", ",".join(FROM_SOURCE), "--no-build-isolation"]
    pip: list[str | Path] = [python, "-I", "-m", "pip", "install", "--disable-pip-version-check"]
    locked = [*pip, *offline, "--require-hashes", "--only-binary", ":all:"]
    build = tomllib.loads((source / "pyproject.toml").read_text("utf-8"))["build-system"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pins = (source / CONSTRAINTS).read_text("utf-8").splitlines()
        bootstrap = folder / "pip.txt"
        bootstrap.write_text("\n".join(pin for pin in pins if pin.startswith("pip==")))
        run(*locked, "-q", "-r", bootstrap, quiet=quiet)
        locked += ["-c", source / CONSTRAINTS]
        if "dev" in extras:
            run(*locked, "-q", *SOURCE_BUILD, quiet=quiet)
        run(*locked, *from_source, *requirements(source, extras), quiet=quiet)
        tool = folder / "hatchling"
        run(*locked, "-q", "--target", tool, *build["requires"], quiet=quiet)
        target = "wheel:editable" if editable else "wheel"
        run(
            python, "-P", "-m", "hatchling", "build", "-t", target, "-d", folder,
            cwd=source, env={"PYTHONPATH": str(tool)},
        )  # fmt: skip
        (wheel,) = folder.glob("*.whl")
        run(*pip, "--no-index", "--no-deps", "--force-reinstall", wheel)


def download_locked(
    extras: Sequence[str], folder: Path, *, minor: int, arm64: bool, source: Path = CHECKOUT
) -> None:
    """Download all packages of an installation, for a computer without a network.

    Args:
        extras: the extras of gyrorig.
        folder: gets the packages.
        minor: of the other computer's Python, 3.MINOR.
        arm64: True if the other computer has an arm64 processor, False if it has an x86-64 one.
        source: a checkout.

    Raises:
        CannotInstallError: pip failed; the text contains the end of its output.
    """
    machine = "aarch64" if arm64 else "x86_64"
    names = (f"{name}_{machine}" for name in ("manylinux_2_28", "manylinux_2_17", "manylinux2014"))
    platforms = (word for name in names for word in ("--platform", name))
    build = tomllib.loads((source / "pyproject.toml").read_text("utf-8"))["build-system"]
    run(
        sys.executable, "-I", "-m", "pip", "download", "--disable-pip-version-check", "-q",
        "--require-hashes", "--only-binary", ":all:", "-c", source / CONSTRAINTS, *platforms,
        "--python-version", f"3.{minor}", "-d", folder,
        "pip", *build["requires"], *requirements(source, extras),
    )  # fmt: skip


def run(
    *command: str | Path,
    cwd: Path | None = None,
    env: Mapping[str, str] = MappingProxyType({}),
    quiet: bool = True,
) -> None:
    """Run a program that must succeed.

    Raises:
        CannotInstallError: it failed; the text contains the end of its output.
    """
    completed = subprocess.run(
        [str(word) for word in command],
        stdout=subprocess.PIPE if quiet else None, stderr=subprocess.STDOUT if quiet else None,
        text=True, check=False, cwd=cwd, env={**os.environ, "PIP_CONSTRAINT": os.devnull, **env},
    )  # fmt: skip
    if completed.returncode != 0:
        words = " ".join(str(word) for word in command[:4])
        output = (completed.stdout or "see the output above").strip()
        raise CannotInstallError(f"{words} failed: {output[-900:]}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Install; return the exit status."""
    parser = argparse.ArgumentParser(prog="locked_install", description=__doc__.split("\n")[0])
    parser.add_argument("--extras", default="", help="separated by commas")
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--python", type=Path, help="install for this interpreter, of a venv")
    action.add_argument("--download", type=Path, metavar="DIR", help="only download the packages")
    parser.add_argument("--editable", action="store_true", help="use the modules of the checkout")
    parser.add_argument("--wheels", type=Path, help="take packages from this folder alone")
    parser.add_argument("--minor", type=int, default=sys.version_info.minor, help="3.MINOR")
    parser.add_argument("--arm64", action="store_true", help="download for an arm64 processor")
    options = parser.parse_args(arguments)
    extras = [extra for extra in options.extras.split(",") if extra]
    try:
        if options.download:
            download_locked(extras, options.download, minor=options.minor, arm64=options.arm64)
        else:
            install_locked(
                options.python.absolute(),
                extras,
                editable=options.editable,
                wheels=options.wheels,
                quiet=False,
            )
    except (CannotInstallError, OSError) as fault:
        print(f"locked_install: {fault}", file=sys.stderr)  # noqa: T201
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
