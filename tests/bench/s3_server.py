"""An object store on this machine, moto's, that refuses a share of what it is asked.

What to use when: `served(errors=0.05)` in tests and benchmarks; it runs as a process of its
own, so that a batch and its workers reach it as they would reach another machine's.

Half of the errors come before the request is carried out (503), half after it: carried out,
and answered with 500, as when an answer is lost on the way.
"""

import argparse
import contextlib
import os
import random
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

BUCKET = "fleet"
_BUSY = b"<Error><Code>ServiceUnavailable</Code><Message>as asked</Message></Error>"
_LOST = b"<Error><Code>InternalError</Code><Message>as asked</Message></Error>"

Environ = dict[str, Any]
Start = Callable[..., Any]


class Faulty:
    """A WSGI application before another one."""

    def __init__(self, inner: Callable[[Environ, Start], Iterable[bytes]], errors: float) -> None:
        self._inner, self._errors = inner, errors
        self._chance = random.Random(1)
        self._lock = threading.Lock()
        self.refused = 0

    def __call__(self, environ: Environ, start: Start) -> Iterable[bytes]:
        with self._lock:
            drawn = self._chance.random()
        if drawn < self._errors / 2:
            start("503 Slow Down", [("Content-Type", "application/xml")])
            return [_BUSY]
        if drawn < self._errors:
            b"".join(self._inner(environ, lambda *_: None))
            start("500 Internal Server Error", [("Content-Type", "application/xml")])
            return [_LOST]
        return self._inner(environ, start)


def environment(port: int) -> dict[str, str]:
    """Return what tells a process of this object store."""
    return {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }


@contextlib.contextmanager
def served(errors: float = 0.0) -> Iterator[dict[str, str]]:
    """Give the environment of an object store that runs while the block does."""
    process = subprocess.Popen(
        [sys.executable, __file__, "--errors", str(errors)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield {**os.environ, **environment(int(process.stdout.readline()))}
    finally:
        process.kill()
        process.communicate()


def main() -> None:
    from moto.moto_server.werkzeug_app import (  # noqa: PLC0415
        DomainDispatcherApplication,
        create_backend_app,
    )
    from werkzeug.serving import make_server  # noqa: PLC0415

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--errors", type=float, default=0.0)
    arguments = parser.parse_args()
    application = Faulty(DomainDispatcherApplication(create_backend_app), 0.0)
    server = make_server("127.0.0.1", 0, application, threaded=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    os.environ.update(environment(server.port))
    import boto3  # type: ignore[import-untyped] # noqa: PLC0415 - its types are a package more

    boto3.client("s3").create_bucket(Bucket=BUCKET)
    application._errors = arguments.errors
    print(server.port, flush=True)  # noqa: T201
    threading.Event().wait()


if __name__ == "__main__":
    main()
