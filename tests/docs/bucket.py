"""Start an object store with a bucket at https://objects.example, in a separate network.

What to use when: `ObjectStore` is a context manager. Its `prefix` runs a command in that network,
which contains nothing else. The server is moto, behind TLS with a new certificate. The bucket and
the profile with its credentials have the name `fleet`.

As a script, this module is the server: `python tests/docs/bucket.py CERTIFICATE KEY`.
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
_CREDENTIALS = f"[{PROFILE}]\naws_access_key_id = test\naws_secret_access_key = test\n"
_CONFIG = f"[profile {PROFILE}]\nregion = us-east-1\n"
_SERVER_SCRIPT = """
set -e
ip link set lo up
mount --bind {hosts} /etc/hosts
exec setpriv --pdeathsig KILL {python} {script} {certificate} {key}
"""


class ObjectStore:
    """A running object store."""

    def __init__(self, folder: Path) -> None:
        """Set the environment of the commands.

        Args:
            folder: an empty folder for the certificate and the credentials.
        """
        self._folder = folder
        self._server: subprocess.Popen[str] | None = None
        self.prefix: tuple[str, ...] = ()
        self.environment = {
            "AWS_CA_BUNDLE": str(folder / "certificate.pem"),
            "AWS_SHARED_CREDENTIALS_FILE": str(folder / "credentials"),
            "AWS_CONFIG_FILE": str(folder / "config"),
            "XDG_CACHE_HOME": str(folder / "cache"),
        }

    @staticmethod
    def find_missing_requirement() -> str:
        """Return which requirement this computer does not meet, or an empty text."""
        if os.geteuid() != 0:
            return "a separate network needs root"
        for program, package in (("nsenter", "util-linux"), ("ip", "iproute2")):
            if shutil.which(program) is None:
                return f"{program} is not installed: install the package {package}"
        return "" if find_spec("moto") else "moto is not installed: pip install moto"

    def __enter__(self) -> "ObjectStore":
        """Start the server, and return when the bucket exists.

        Raises:
            RuntimeError: the server does not start.
        """
        folder = self._folder
        certificate, key, hosts = (folder / name for name in ("certificate.pem", "key", "hosts"))
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
             "-nodes", "-days", "1", "-subj", f"/CN={NAME}", "-keyout", key, "-out", certificate,
             "-addext", f"subjectAltName=DNS:{NAME}"], check=True, capture_output=True,
        )  # fmt: skip
        (folder / "credentials").write_text(_CREDENTIALS)
        (folder / "config").write_text(_CONFIG)
        hosts.write_text(f"127.0.0.1 localhost {NAME}\n")
        script = _SERVER_SCRIPT.format(
            hosts=hosts, python=sys.executable, script=__file__, certificate=certificate, key=key
        )
        self._server = subprocess.Popen(
            ["unshare", "--net", "--mount", "--propagation", "private", "bash", "-c", script],
            env={
                **os.environ, **self.environment, "AWS_PROFILE": PROFILE,
                "S3_IGNORE_SUBDOMAIN_BUCKETNAME": "true",  # otherwise `objects` is the bucket
            },
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        line = self._server.stdout.readline() if self._server.stdout else ""
        if not line:
            _, errors = self._server.communicate()
            raise RuntimeError(
                f"the object store does not start: {errors.strip().splitlines()[-3:]}"
            )
        self.prefix = ("nsenter", "--target", str(self._server.pid), "--net", "--mount")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the server."""
        if self._server is not None:
            self._server.kill()
            self._server.communicate()


def main(certificate: str, key: str) -> None:
    """Serve the bucket, and print a line when it exists."""
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
    import boto3  # type: ignore[import-untyped] # noqa: PLC0415 - its types need another package

    boto3.client("s3", endpoint_url=f"https://{NAME}").create_bucket(Bucket=BUCKET)
    sys.stderr = open(os.devnull, "w")  # noqa: PTH123, SIM115 - moto logs each request
    print("ready", flush=True)  # noqa: T201
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
