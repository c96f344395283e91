"""The firmware, built by the host's compilers; a library to call, and programs to run."""

import shutil
import subprocess
from collections.abc import Callable
from ctypes import CDLL
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[1] / "firmware_protocol" / "firmware"
STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", f"-I{FIRMWARE / 'src'}"]
C99 = ["-std=c99", *STRICT]
SOURCE = FIRMWARE / "src" / "gyrorig_board.c"

Build = Callable[..., Path]


def compiler(*names: str) -> str:
    actual = next((path for name in names if (path := shutil.which(name))), None)
    if actual is None:
        pytest.skip(f"no {' or '.join(names)} here: install gcc (apt install build-essential)")
    return actual


def run_compiler(*arguments: str | Path) -> None:
    process = subprocess.run(
        [str(word) for word in arguments], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr


@pytest.fixture(scope="session")
def c_build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compile a C file of this folder together with the firmware."""
    gcc = compiler("gcc", "cc")
    folder = tmp_path_factory.mktemp("firmware")

    def build(name: str, *flags: str) -> Path:
        program = folder / f"{name.removesuffix('.c')}-{len(list(folder.iterdir()))}"
        run_compiler(gcc, *C99, *flags, HERE / name, SOURCE, "-o", program)
        return program

    return build


@pytest.fixture(scope="session")
def library(c_build: Build) -> CDLL:
    """The firmware and `virtual_board.c`, to be called."""
    return CDLL(str(c_build("virtual_board.c", "-shared", "-fPIC")))


@pytest.fixture(scope="session")
def host_board(c_build: Build) -> Path:
    """The board as a program: a descriptor and the samples in a frame are its arguments."""
    return c_build("host_board.c", "-D_POSIX_C_SOURCE=200809L")


@pytest.fixture(scope="session")
def gapless_board(c_build: Build) -> Path:
    """The same, but it loses no sample before it is read."""
    return c_build("host_board.c", "-D_POSIX_C_SOURCE=200809L", "-DGAP_EVERY=1000000u")


AVR_MEMORY = ["-DGYB_QUEUE_BYTES=192", "-DGYB_BATCH_BYTES=107"]  # the defaults of an AVR


@pytest.fixture(scope="session", params=[[], AVR_MEMORY], ids=["large", "small"])
def fuzzer(request: pytest.FixtureRequest, c_build: Build) -> Path:
    """`fuzz_board.c` with the sanitizers."""
    sanitizers = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
    return c_build("fuzz_board.c", *sanitizers, *request.param)


@pytest.fixture(scope="session")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The GY-80 sketch on the shim of the Arduino API, with the sanitizers."""
    gcc, gxx = compiler("gcc", "cc"), compiler("g++", "c++")
    folder = tmp_path_factory.mktemp("sketch")
    example = FIRMWARE / "examples" / "gy80"
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    run_compiler(gcc, *C99, *sanitizers, "-c", SOURCE, "-o", folder / "board.o")
    cpp = ["-std=c++11", *STRICT, *sanitizers, f"-I{HERE / 'shim'}", f"-I{example}"]
    sources = [example / "gy80_sensors.cpp", HERE / "shim" / "shim.cpp"]
    ino: list[str | Path] = ["-x", "c++", example / "gy80.ino"]
    run_compiler(gxx, *cpp, folder / "board.o", *sources, *ino, "-o", folder / "gy80")
    return folder / "gy80"
