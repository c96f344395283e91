"""The machine's disk: a small Debian with the service installed as on a Pi.

What to use when: `disk(folder)` once; it takes minutes and a network, and is kept until the
checkout or the guest's script changes. Needs root, mmdebstrap and mke2fs.
"""

import hashlib
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GUEST = Path(__file__).with_name("l3_guest.py")
SUITE = "bookworm"
PACKAGES = (
    "systemd,systemd-sysv,dbus,udev,python3,python3-venv,linux-image-amd64,initramfs-tools,kmod,"
    "iproute2,procps"
)
SIZE = "4G"
UNIT = """[Unit]
Description=The test's driver
After=multi-user.target
[Service]
Environment=OPENBLAS_NUM_THREADS=1
ExecStart=/opt/gyrorig/bin/python /opt/l3/l3_guest.py
StandardError=file:/dev/ttyS1
[Install]
WantedBy=multi-user.target
"""


@dataclass(frozen=True, slots=True)
class Image:
    """What a machine starts from."""

    disk: Path
    kernel: Path
    initrd: Path


def run(*words: str | Path) -> None:
    """Run a program that has to succeed."""
    ended = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False
    )
    if ended.returncode != 0:
        raise RuntimeError(f"{words[0]} failed: {(ended.stdout + ended.stderr)[-1500:]}")


def disk(folder: Path) -> Image:
    """Return the image in `folder`, made where it is missing or old."""
    folder.mkdir(parents=True, exist_ok=True)
    debian = folder / "debian.tar"
    if not debian.exists():
        part = folder / "debian.part.tar"
        run("mmdebstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, part)
        part.rename(debian)
    image = Image(folder / "disk.ext4", folder / "vmlinuz", folder / "initrd.img")
    mark = folder / "made-of.sha256"
    state = state_of_checkout()
    if image.disk.exists() and mark.exists() and mark.read_text() == state:
        return image
    tree = folder / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    tree.mkdir()
    run("tar", "-xf", debian, "-C", tree, "--exclude=./dev/*")
    run(sys.executable, ROOT / "systemd" / "install.py", "--root", tree)
    (tree / "opt" / "l3").mkdir()
    shutil.copy(GUEST, tree / "opt" / "l3" / GUEST.name)
    unit = tree / "etc" / "systemd" / "system" / "l3.service"
    unit.write_text(UNIT)
    run("systemctl", f"--root={tree}", "enable", unit.name)
    (tree / "etc" / "hostname").write_text("gyrorig-l3\n")
    (tree / "etc" / "fstab").write_text("/dev/vda / ext4 rw 0 0\n")
    image.kernel.write_bytes(next((tree / "boot").glob("vmlinuz-*")).read_bytes())
    image.initrd.write_bytes(next((tree / "boot").glob("initrd.img-*")).read_bytes())
    image.disk.unlink(missing_ok=True)
    run("mke2fs", "-q", "-F", "-t", "ext4", "-d", tree, image.disk, SIZE)
    shutil.rmtree(tree)
    mark.write_text(state)
    return image


def state_of_checkout() -> str:
    """Return what tells one state of what goes into the image from another."""
    digest = hashlib.sha256()
    folders = ("daemon", "firmware_protocol", "systemd", "solver")
    paths = [path for name in folders for path in sorted((ROOT / name).rglob("*.py"))]
    paths += [path for path in sorted((ROOT / "systemd").rglob("*")) if path.is_file()]
    for path in [*paths, GUEST, Path(__file__), ROOT / "constraints.txt"]:
        digest.update(path.read_bytes())
    return digest.hexdigest()
