"""A network of its own in which https://objects.example is an object store with a bucket.

What to use when: `ObjectStore`, a context; `prefix` brings a command into that network, where
nothing else is. The store is moto's, behind TLS with a certificate made for it; the bucket is
`fleet`, and so is the name of the profile that has its credentials.

Run by itself it is the store: `python tests/docs/bucket.py CERTIFICATE KEY`.
"""

import os
import shutil
import ssl
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType

NAME, BUCKET, PROFILE = "objects.example", "fleet", "fleet"
_SECRETS = f"[{PROFILE}]\naws_access_key_id = test\naws_secret_access_key = test\n"
_REGION = f"[profile {PROFILE}]\nregion = us-east-1\n"
_NETWORK = """
set -e
ip link set lo up
mount --bind {hosts} /etc/hosts
exec setpriv --pdeathsig KILL {python} {script} {certificate} {key}
"""


class ObjectStore:
    """A running object store."""

    def __init__(self, folder: Path) -> None:
        """Prepare it.

        Args:
            folder: an empty one, for its certificate and credentials.
        """
        self._folder = folder
        self._running: subprocess.Popen[str] | None = None
        self.prefix: tuple[str, ...] = ()
        self.environment = {
            "AWS_CA_BUNDLE": str(folder / "certificate.pem"),
            "AWS_SHARED_CREDENTIALS_FILE": str(folder / "credentials"),
            "AWS_CONFIG_FILE": str(folder / "config"),
            "XDG_CACHE_HOME": str(folder / "cache"),
        }

    @staticmethod
    def why_not() -> str:
        """Return why there can be no such network here, "" where there can."""
        if os.geteuid() != 0:
            return "a network of its own needs root"
        for program, package in (("nsenter", "util-linux"), ("ip", "iproute2")):
            if shutil.which(program) is None:
                return f"no {program} here: it comes with the package {package}"
        return "" if find_spec("moto") else "no moto here: pip install moto"

    def __enter__(self) -> "ObjectStore":
        """Begin; returns when the bucket is there.

        Raises:
            RuntimeError: it does not come up.
        """
        folder = self._folder
        certificate, key, hosts = (folder / name for name in ("certificate.pem", "key", "hosts"))
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
             "-nodes", "-days", "1", "-subj", f"/CN={NAME}", "-keyout", key, "-out", certificate,
             "-addext", f"subjectAltName=DNS:{NAME}"], check=True, capture_output=True,
        )  # fmt: skip
        (folder / "credentials").write_text(_SECRETS)
        (folder / "config").write_text(_REGION)
        hosts.write_text(f"127.0.0.1 localhost {NAME}\n")
        script = _NETWORK.format(
            hosts=hosts, python=sys.executable, script=__file__, certificate=certificate, key=key
        )
        self._running = subprocess.Popen(
            ["unshare", "--net", "--mount", "--propagation", "private", "bash", "-c", script],
            env={
                **os.environ, **self.environment, "AWS_PROFILE": PROFILE,
                "S3_IGNORE_SUBDOMAIN_BUCKETNAME": "true",  # or `objects` would be the bucket
            },
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        line = self._running.stdout.readline() if self._running.stdout else ""
        if not line:
            _, words = self._running.communicate()
            raise RuntimeError(f"no object store comes up here: {words.strip().splitlines()[-3:]}")
        self.prefix = ("nsenter", "--target", str(self._running.pid), "--net", "--mount")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it."""
        if self._running is not None:
            self._running.kill()
            self._running.communicate()


def main(certificate: str, key: str) -> None:
    """Serve, and say a word when the bucket is there."""
    from moto.moto_server.werkzeug_app import (  # noqa: PLC0415
        DomainDispatcherApplication,
        create_backend_app,
    )
    from werkzeug.serving import make_server  # noqa: PLC0415

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    application = DomainDispatcherApplication(create_backend_app)
    server = make_server("127.0.0.1", 443, application, threaded=True, ssl_context=context)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    import boto3  # type: ignore[import-untyped] # noqa: PLC0415 - its types are a package more

    boto3.client("s3", endpoint_url=f"https://{NAME}").create_bucket(Bucket=BUCKET)
    sys.stderr = open(os.devnull, "w")  # noqa: PTH123, SIM115 - a line a request, which nobody reads
    print("ready", flush=True)  # noqa: T201
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
