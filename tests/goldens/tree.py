"""Run the programs of one source tree, and the object store that some of them talk to.

What to use when: `Tree` for a command of a case; `object_store` around all cases.
"""

import contextlib
import logging
import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from moto.server import ThreadedMotoServer
from tests.goldens.cases import Case
from tests.goldens.collect import Result, result_of

CLOCK = Path(__file__).resolve().parent / "clock"
PACKAGES = ("daemon", "solver", "firmware_protocol")
MODULES = {"gyrorig": "gyrorig_solver", "gyrorigd": "gyrorig_daemon"}
LIMIT_S = 600.0
BUCKET = "fleet"
# One thread: sums of several threads differ in their last digits from run to run.
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


@dataclass(frozen=True, slots=True)
class Tree:
    """A source tree under test.

    Attributes:
        root: the tree.
        python: interpreter that has what the programs need.
        environment: of the programs.
    """

    root: Path
    python: Path
    environment: dict[str, str]

    @classmethod
    def at(cls, root: Path, more: dict[str, str]) -> "Tree":
        """Return the tree at a folder, with its own virtual environment if it has one.

        Args:
            root: folder of the tree.
            more: environment variables to add.
        """
        venv_python = root / ".venv" / "bin" / "python"
        python = venv_python if venv_python.exists() else Path(sys.executable)
        environment = {
            k: v for k, v in os.environ.items() if not k.startswith(("GYRORIG_", "PYTHON"))
        }
        path = os.pathsep.join(str(root / package) for package in PACKAGES)
        fixed = {"PYTHONPATH": path, "TZ": "UTC", "LC_ALL": "C.UTF-8", "COLUMNS": "80"}
        return cls(root, python, environment | _ONE_THREAD | fixed | more)

    def run(self, case: Case, work: Path) -> Result:
        """Run one case in the working folder and return what it left.

        Raises:
            subprocess.TimeoutExpired: the command has not ended after ten minutes.
        """
        program, *words = case.words()
        arguments = [part for word in words for part in _expanded(word, work)]
        environment = dict(self.environment)
        if case.clock_ns:
            environment["PYTHONPATH"] = f"{CLOCK}{os.pathsep}{environment['PYTHONPATH']}"
            environment["GOLDENS_CLOCK_NS"] = str(case.clock_ns)
        (work / case.name).mkdir(exist_ok=True)
        process = subprocess.run(
            [str(self.python), "-m", MODULES[program], *arguments],
            cwd=work,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        return result_of(
            process.returncode, process.stdout, process.stderr, work / case.output_folder
        )

    def check(self) -> None:
        """Check that the interpreter takes the programs from this tree.

        Raises:
            FileNotFoundError: it takes them from elsewhere, or there are none.
        """
        find = "import importlib.util as u, sys; print(u.find_spec(sys.argv[1]).origin)"
        for module in MODULES.values():
            command = [str(self.python), "-c", find, module]
            process = subprocess.run(
                command, env=self.environment, capture_output=True, text=True, check=False
            )
            origin = process.stdout.strip()
            if not origin.startswith(f"{self.root}{os.sep}"):
                raise FileNotFoundError(f"{module} is not taken from {self.root}, but: {origin}")


def _expanded(word: str, work: Path) -> list[str]:
    """Return a word, or the sorted names that a star in it stands for."""
    if "*" not in word:
        return [word]
    return sorted(path.relative_to(work).as_posix() for path in work.glob(word)) or [word]


@contextlib.contextmanager
def object_store() -> Iterator[dict[str, str]]:
    """Run an object store with an empty bucket; give the environment that names it."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)  # or each request is a line
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        address = f"http://{host}:{port}"
        request = urllib.request.Request(f"{address}/{BUCKET}", method="PUT")  # noqa: S310
        urllib.request.urlopen(request).close()  # noqa: S310 - the address is made here
        yield {
            "AWS_ENDPOINT_URL": address,
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_DEFAULT_REGION": "us-east-1",
            "NO_PROXY": host,
            "no_proxy": host,
        }
    finally:
        server.stop()
