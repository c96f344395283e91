"""An installation takes only packages with digests of constraints.txt, and names licences."""

import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "release"))

import lock  # noqa: E402
import third_party  # noqa: E402
from locked_install import CannotInstallError, install_locked, requirements  # noqa: E402

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


@pytest.mark.parametrize(
    ("wheel", "taken"),
    [
        ("click-8.5.1-py3-none-any.whl", True),
        ("numpy-2.4.6-cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl", True),
        ("numpy-2.4.6-cp314-cp314-manylinux_2_27_aarch64.manylinux_2_28_aarch64.whl", True),
        ("numpy-2.4.6-cp314-cp314t-manylinux_2_28_x86_64.whl", False),  # without the GIL
        ("numpy-2.4.6-cp310-cp310-manylinux_2_28_x86_64.whl", False),
        ("numpy-2.4.6-cp311-cp311-musllinux_1_2_x86_64.whl", False),
        ("numpy-2.4.6-cp311-cp311-win_amd64.whl", False),
        ("numpy-2.4.6-cp311-cp311-macosx_14_0_arm64.whl", False),
        ("psutil-7.2.2-cp36-abi3-manylinux2014_aarch64.manylinux_2_17_aarch64.whl", True),
        ("ruff-0.17.5-py3-none-manylinux_2_17_armv7l.manylinux2014_armv7l.whl", False),
        ("uv-0.13.9-py3-none-manylinux_2_17_x86_64.manylinux2014_x86_64.whl", True),
    ],
)
def test_wheels_for_supported_computers_are_locked(wheel: str, taken: bool) -> None:
    assert lock.is_for_here(wheel) is taken


def test_a_source_archive_is_locked_only_without_a_wheel() -> None:
    sdist = {"hashes": {"sha256": "s"}}
    wheel = {"url": "https://x/a-1-py3-none-any.whl", "hashes": {"sha256": "w"}}
    windows = {"url": "https://x/a-1-cp311-cp311-win_amd64.whl", "hashes": {"sha256": "d"}}
    package = {"name": "a", "version": "1", "sdist": sdist, "wheels": [windows, wheel]}
    assert lock.lock_text([package]).splitlines()[-1] == "a==1 --hash=sha256:w"
    package["wheels"] = [windows]
    assert lock.lock_text([package]).splitlines()[-1] == "a==1 --hash=sha256:s"


def test_an_extra_has_the_requirements_of_the_extras_that_it_names() -> None:
    names = {canonicalize_name(Requirement(text).name) for text in requirements(ROOT, ["fleet"])}
    assert {"numpy", "scipy", "jinja2", "duckdb"} <= names
    assert "gyrorig" not in names
    with pytest.raises(CannotInstallError, match="no extra nonesuch"):
        requirements(ROOT, ["nonesuch"])


def test_an_isolated_build_takes_exact_versions_only() -> None:
    pins = {}
    for text in PYPROJECT["build-system"]["requires"]:
        requirement = Requirement(text)
        (specifier,) = requirement.specifier
        assert specifier.operator == "=="
        pins[canonicalize_name(requirement.name)] = specifier.version
    waiting = ["hatchling"]
    while waiting:
        name = waiting.pop()
        assert pins.get(canonicalize_name(name)) == distribution(name).version
        for text in distribution(name).requires or []:
            needed = Requirement(text)
            if needed.marker is None or needed.marker.evaluate({"extra": ""}):
                waiting.append(needed.name)


@pytest.mark.long
def test_a_package_with_another_digest_is_refused(tmp_path: Path) -> None:
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    (pin,) = (
        line.split()[0].partition("==")[2]
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if line.startswith("pip==")
    )
    with zipfile.ZipFile(wheels / f"pip-{pin}-py3-none-any.whl", "w") as archive:
        archive.writestr(f"pip-{pin}.dist-info/METADATA", f"Name: pip\nVersion: {pin}\n")
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    with pytest.raises(CannotInstallError, match="DO NOT MATCH THE HASHES"):
        install_locked(tmp_path / "venv" / "bin" / "python", [], wheels=wheels)


def test_the_notice_names_every_package_of_the_service() -> None:
    text = third_party.PATH.read_text("utf-8")
    if sys.version_info[:2] == (3, 11):
        assert text == third_party.document(), "run `make third-party`"
    for name, package in third_party.closure().items():
        assert f"| {name} | {package.version} | " in text
    assert "`python-can` (LGPL-3.0-only)" in text


def test_the_wheel_contains_the_notice() -> None:
    assert third_party.PATH.name in PYPROJECT["project"]["license-files"]
