"""A batch on a scheduler behind TLS: with the right certificate, and with a stranger's."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
)
from cryptography.x509.oid import NameOID
from tests.system.conftest import Clusters

from gyrorig_solver.fleet.store import verify

pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install .[fleet]")

DONE, BUSY = 0, 75
CLUSTER = """
import sys
from distributed import LocalCluster
from distributed.security import Security
if __name__ == "__main__":
    ca, cert, key = sys.argv[1:]
    sides = {f"tls_{side}_{kind}": path for side in ("scheduler", "worker", "client")
             for kind, path in (("cert", cert), ("key", key))}
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None,
                      protocol="tls", security=Security(tls_ca_file=ca, require_encryption=True,
                                                        **sides)) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def certificates(folder: Path) -> list[str]:
    """Make an authority and a certificate of it; return the three files that TLS needs."""
    folder.mkdir()
    subject_name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, folder.name)])
    now = datetime.now(UTC)
    signing = ec.generate_private_key(ec.SECP256R1())
    files = []
    for name, ca in (("authority", True), ("member", False)):
        key = signing if ca else ec.generate_private_key(ec.SECP256R1())
        subject = subject_name if ca else x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        made = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject_name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - timedelta(hours=1))
            .not_valid_after(now + timedelta(hours=1))
            .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
            .sign(signing, SHA256())
        )
        path = folder / f"{name}.pem"
        path.write_bytes(made.public_bytes(Encoding.PEM))
        files.append(path)
        if not ca:
            path = folder / f"{name}.key"
            path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
            files.append(path)
    return [str(path) for path in files]


@pytest.fixture
def ours(tmp_path: Path) -> list[str]:
    return certificates(tmp_path / "ours")


@pytest.fixture
def address(clusters: Clusters, ours: list[str]) -> Iterator[str]:
    with clusters(CLUSTER, ours) as (_, at):
        yield at


def batch(tmp_path: Path, address: str, files: list[str]) -> "subprocess.CompletedProcess[str]":
    words = [str(Path(sys.executable).with_name("gyrorig")), "batch", "--json"]
    words += ["--spool", str(tmp_path / "spool"), "--store", str(tmp_path / "store")]
    words += ["--scheduler", address]
    for option, path in zip(("--tls-ca", "--tls-cert", "--tls-key"), files, strict=True):
        words += [option, path]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_only_our_certificate_is_accepted(
    tmp_path: Path, contracts: Path, ours: list[str], address: str
) -> None:
    assert address.startswith("tls://")
    (tmp_path / "spool").mkdir()
    shutil.copy(contracts / "sample.mcap", tmp_path / "spool")

    refused = batch(tmp_path, address, certificates(tmp_path / "strangers"))
    assert refused.returncode == BUSY, refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
    assert "no scheduler answers at the address tls://" in refused.stderr

    process = batch(tmp_path, address, ours)
    assert process.returncode == DONE, process.stderr
    assert json.loads(process.stdout)["ended"] == {"ok": 1}
    assert verify(tmp_path / "store").faults == ()
