"""What a store holds, sealed: damage is seen, forgery too where there is a key."""

import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.jobs import SolveSettings, run_batch
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import read_signer, rebuild_index, verify
from gyrorig_solver.fleet.store.manifest import read_public_key, write_manifests
from gyrorig_solver.storage import Folder


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("keys")
    key = Ed25519PrivateKey.generate()
    private, public = folder / "key.pem", folder / "public.pem"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    form = PublicFormat.SubjectPublicKeyInfo
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, form))
    return private, public


@pytest.fixture(scope="module")
def sealed(
    recorded: list[Path], keys: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("sealed")
    (folder / "spool").mkdir()
    for number, path in enumerate(recorded):
        shutil.copy(path, folder / "spool" / f"{number}.mcap")
    pools = [WorkerPool(lambda: ThreadPoolExecutor(1))]
    run_batch(
        folder / "spool",
        folder / "store",
        SolveSettings(solver_version="0.1.0", extend=()),
        pools,
        signer=read_signer(keys[0]),
    )
    return folder / "store"


@pytest.fixture
def store(sealed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sealed, tmp_path / "store"))


def item(store: Path, pattern: str) -> Path:
    return min(store.glob(pattern))


def test_a_signed_store_verifies(store: Path, keys: tuple[Path, Path]) -> None:
    result = verify(store, read_public_key(keys[1]))
    assert (result.faults, result.versions, result.manifest_files) == ((), 2, 4)


def test_sha256sum_and_openssl_check_manifests(store: Path, keys: tuple[Path, Path]) -> None:
    manifest = item(store, "manifest/*.sha256")
    if shutil.which("sha256sum"):
        process = subprocess.run(
            ["sha256sum", "--check", "--strict", str(manifest.relative_to(store))],
            cwd=store,
            capture_output=True,
            text=True,
            check=False,
        )
        assert process.returncode == 0, process.stderr
        assert process.stdout.count(": OK") == 5
    if shutil.which("openssl"):
        command = ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", str(keys[1]), "-rawin"]
        command += ["-in", str(manifest), "-sigfile", f"{manifest}.sig"]
        subprocess.run(command, check=True, capture_output=True)


def garbled(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1] + b"\n \n")


@pytest.mark.parametrize(
    ("pattern", "harm", "kind"),
    [
        ("calib/*/*/*/v0001.yaml", garbled, "damaged"),
        ("calib/*/*/*/v0001.yaml", Path.unlink, "missing"),
        ("calib/*/*/*/v0002.report.html", garbled, "damaged"),
        ("calib/*/*/*/v0002.report.html", Path.unlink, "missing"),
        ("index/*.parquet", Path.unlink, "missing"),
        ("manifest/*.sha256", garbled, "unsigned"),
        ("manifest/*.sha256", Path.unlink, "unsigned"),
        ("manifest/*.sig", garbled, "unsigned"),
        ("manifest/*.sig", Path.unlink, "unsigned"),
    ],
)
def test_changed_files_are_reported(
    store: Path,
    keys: tuple[Path, Path],
    pattern: str,
    harm: Callable[[Path], None],
    kind: str,
) -> None:
    harm(item(store, pattern))
    assert kind in {fault.kind for fault in verify(store, read_public_key(keys[1])).faults}


def test_a_forgery_with_correct_digests_is_detected(store: Path, keys: tuple[Path, Path]) -> None:
    """The last version, its row and its manifest are all made anew: only the key knows."""
    path = item(store, "calib/*/*/*/v0002.yaml")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("verdict: ", "verdict:  ", 1), encoding="utf-8")
    rebuild_index(store)
    assert verify(store).faults == ()
    assert {fault.kind for fault in verify(store, read_public_key(keys[1])).faults} == {"unsigned"}
    rebuild_index(store, read_signer(keys[0]))
    assert verify(store, read_public_key(keys[1])).faults == ()


def test_the_next_batch_completes_interrupted_manifests(store: Path) -> None:
    manifest = item(store, "manifest/*.sha256")
    before = manifest.read_bytes()
    manifest.unlink()
    assert write_manifests(Folder(store), None) == 1
    assert manifest.read_bytes() == before
    assert write_manifests(Folder(store), None) == 0


def test_an_invalid_key_is_refused(keys: tuple[Path, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.pem"
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    other.write_bytes(generate_private_key(SECP256R1()).private_bytes(*form))
    for path in (keys[1], other, tmp_path / "none"):
        with pytest.raises(UsageError, match="openssl genpkey"):
            read_signer(path)
    for path in (keys[0], tmp_path / "none"):
        with pytest.raises(UsageError, match="openssl pkey"):
            read_public_key(path)


def test_the_command_exits_with_3_for_another_key(
    store: Path, keys: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["store", "verify", str(store), "--key", str(keys[1])]) == 0
    other = tmp_path / "public.pem"
    form = (Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    other.write_bytes(Ed25519PrivateKey.generate().public_key().public_bytes(*form))
    assert run(["store", "verify", str(store), "--key", str(other)]) == 3
    assert "the manifest is not signed with this key" in capsys.readouterr().out


def test_a_batch_signs_only_what_it_wrote(store: Path, keys: tuple[Path, Path]) -> None:
    """A forged version with its row lies in the store when the owner's next batch ends."""
    signature = item(store, "manifest/*.sha256.sig")
    for name in (signature, item(store, "manifest/*.sha256")):
        name.unlink()
    assert write_manifests(Folder(store), read_signer(keys[0]), []) == 1
    assert not signature.exists()
    assert {fault.kind for fault in verify(store, read_public_key(keys[1])).faults} == {"unsigned"}


def test_a_roll_back_is_detected(store: Path, keys: tuple[Path, Path], tmp_path: Path) -> None:
    heads = tmp_path / "heads.txt"
    command = ["store", "verify", str(store), "--key", str(keys[1])]
    assert run([*command, "--write-heads", str(heads)]) == 0
    assert run([*command, "--at-least", str(heads)]) == 0
    older = Path(shutil.copytree(store, tmp_path / "older"))
    for pattern in ("calib/*/*/*/v0002*", "manifest/*"):
        for path in older.glob(pattern):
            path.unlink()
    kinds = {(fault.kind, Path(fault.file).name) for fault in verify(older, None, heads).faults}
    assert ("rolled back", "v0002.yaml") in kinds
    assert run(["store", "verify", str(older), "--at-least", str(heads)]) == 3
    heads.write_text("no list\n")
    assert run([*command, "--at-least", str(heads)]) == 3
