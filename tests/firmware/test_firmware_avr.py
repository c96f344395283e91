"""The sketch as an Uno gets it: avr-gcc, Debian's Arduino core, and what fits into 2 KiB.

What is compiled here and nowhere else are the lines that ask an AVR's own UART, and the
library against the real headers of Arduino, Wire and EEPROM.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware_protocol" / "firmware"
CORE = Path("/usr/share/arduino/hardware/arduino/avr")  # Debian's arduino-core-avr
FLASH_BYTES, MEMORY_BYTES = 32 * 1024 - 512, 2048  # ATmega328P, without the Uno's bootloader
# main, loop, gyb_poll, write_slow, at_first_byte: 0.2 KiB by -fstack-usage; an interrupt 40
STACK_BYTES = 300
COMMON = [
    "-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10807", "-DARDUINO_AVR_UNO",
    "-DARDUINO_ARCH_AVR", "-Os", "-ffunction-sections", "-fdata-sections",
    *(f"-I{CORE / folder}" for folder in (
        "cores/arduino", "variants/standard", "libraries/Wire/src", "libraries/EEPROM/src")),
    f"-I{FIRMWARE / 'src'}", f"-I{FIRMWARE / 'examples/gy80'}",
]  # fmt: skip
OURS = ["-Wall", "-Wextra", "-Werror"]
CPP = ["-std=gnu++11", "-fno-exceptions", "-fno-threadsafe-statics"]
# avr-libc 2.0 has no DECIMAL_DIG in C++, which the core's String wants
THEIRS = ["-w", "-D__STDC_LIMIT_MACROS", "-DDECIMAL_DIG=9"]


def needed() -> tuple[str, str]:
    gcc, gxx = shutil.which("avr-gcc"), shutil.which("avr-g++")
    if gcc is None or gxx is None or not Path("/usr/lib/avr/include/avr/io.h").exists():
        pytest.skip("no avr-gcc here: apt install gcc-avr avr-libc")
    if not CORE.is_dir():
        pytest.skip("no Arduino core here: apt install arduino-core-avr")
    return gcc, gxx


def run(*command: str | Path) -> str:
    ended = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sketch, linked with the core for an Uno."""
    gcc, gxx = needed()
    folder = tmp_path_factory.mktemp("avr")
    example = FIRMWARE / "examples" / "gy80"
    run(
        gcc,
        *COMMON,
        "-std=gnu99",
        *OURS,
        "-c",
        FIRMWARE / "src/gyrorig_board.c",
        "-o",
        folder / "board.o",
    )
    for name in ("gy80_sensors.cpp", "gy80.ino"):
        run(
            gxx, *COMMON, *CPP, *OURS, "-x", "c++", "-c", example / name, "-o", folder / f"{name}.o"
        )
    wire = CORE / "libraries" / "Wire" / "src"
    for path in [*(CORE / "cores/arduino").glob("*.cpp"), wire / "Wire.cpp"]:
        run(gxx, *COMMON, *CPP, *THEIRS, "-c", path, "-o", folder / f"{path.name}.o")
    for path in [*(CORE / "cores/arduino").glob("*.c"), wire / "utility" / "twi.c"]:
        run(gcc, *COMMON, "-std=gnu11", "-w", "-c", path, "-o", folder / f"{path.name}.o")
    objects = sorted(folder.glob("*.o"))
    run(
        gcc,
        "-mmcu=atmega328p",
        "-Os",
        "-Wl,--gc-sections",
        *objects,
        "-lm",
        "-o",
        folder / "gy80.elf",
    )
    return folder / "gy80.elf"


def test_the_sketch_fits_into_an_uno(program: Path) -> None:
    output = run("avr-size", "-C", "--mcu=atmega328p", program)
    flash = int(re.findall(r"Program:\s+(\d+) bytes", output)[0])
    memory = int(re.findall(r"Data:\s+(\d+) bytes", output)[0])
    assert flash <= FLASH_BYTES
    assert memory <= MEMORY_BYTES - STACK_BYTES, f"{memory} bytes: too little stack is left"
