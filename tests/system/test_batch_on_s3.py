"""The real command on an object store that refuses a share of what it is asked."""

import importlib.util
import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("moto", reason="moto is not installed")
GYRORIG = str(Path(sys.executable).with_name("gyrorig"))
ROOT = Path(__file__).resolve().parents[2]


def s3_server() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "s3_server", ROOT / "tests" / "bench" / "s3_server.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_batch_on_an_object_store_with_errors(tmp_path: Path, contracts: Path) -> None:
    server = s3_server()
    spool = tmp_path / "spool"
    spool.mkdir()
    shutil.copy(contracts / "sample.mcap", spool)
    for number in range(4):
        (spool / f"foreign{number}.mcap").write_bytes(b"%d" % number)
    store = f"s3://{server.BUCKET}/night"
    batch = [GYRORIG, "batch", "--spool", str(spool), "--store", store, "--workers", "1", "--json"]
    with server.served(errors=0.04) as environment:
        environment["XDG_CACHE_HOME"] = str(tmp_path / "cache")

        def run(*command: str) -> "subprocess.CompletedProcess[str]":
            return subprocess.run(
                command, env=environment, capture_output=True, text=True, check=False
            )

        ended: Counter[str] = Counter()
        for _ in range(6):  # what one night puts off the next one does
            result = run(*batch)
            if result.returncode in (0, 5):
                ended += Counter(json.loads(result.stdout)["ended"])
            if sum(ended.values()) == 5:
                break
        assert ended == Counter(ok=1, rejected=4), result.stderr
        for _ in range(6):
            verified = run(GYRORIG, "store", "verify", store, "--json")
            if verified.returncode != 1:  # a listing was refused: asked again
                break
        assert verified.returncode == 0, verified.stdout + verified.stderr
        assert json.loads(verified.stdout)["versions"] == 1


def test_an_unreachable_bucket_is_reported_in_one_line(tmp_path: Path) -> None:
    environment = s3_server().environment(9)  # nobody listens at the discard port
    process = subprocess.run(
        [GYRORIG, "batch", "--spool", str(tmp_path), "--store", "s3://none/there"],
        env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 1
    assert len(process.stderr.strip().splitlines()) == 1
    assert "s3://none/there" in process.stderr
