"""The same load, recorded as one would without this project: a side-by-side.

    python -m tests.bench.daemon_load.plain OUT SECONDS PTY... -- PORT...

python-can's Logger on each bus, in one process with a Notifier as its documentation has it;
pyserial's `read_until` on each port (`readline` for frames that end in a zero byte), one thread
a port, into one mcap file. Arrival is when the library hands the frame over, or for CAN the
time that python-can gives it.
"""

import struct
import sys
import threading
import time
from pathlib import Path

import can
import serial
from mcap.writer import CompressionType, Writer
from tests.bench.daemon_load.load import GROUP

STAMPED = struct.Struct("<q")


def main() -> None:
    """Record until the time is over."""
    out, seconds = Path(sys.argv[1]), float(sys.argv[2])
    split = sys.argv.index("--")
    ports, buses = sys.argv[3:split], [int(word) for word in sys.argv[split + 1 :]]
    over = threading.Event()
    with (out / "serial.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema("bytes", "", b"")
        lock = threading.Lock()
        threads = []
        for number, path in enumerate(ports):
            channel = writer.register_channel(f"/serial/{number}", "", schema)
            arguments = (path, writer, channel, lock, over)
            threads.append(threading.Thread(target=read_port, args=arguments))
        notifiers = []
        for number, port in enumerate(buses):
            bus = can.Bus(interface="udp_multicast", channel=GROUP, port=port)
            logger = can.Logger(out / f"can{number}.blf")
            notifiers.append((can.Notifier(bus, [logger]), bus))
        for thread in threads:
            thread.start()
        print("ready", flush=True)  # noqa: T201
        time.sleep(seconds)
        over.set()
        for thread in threads:
            thread.join()
        for notifier, bus in notifiers:
            notifier.stop()  # and the logger with it
            bus.shutdown()
        writer.finish()  # type: ignore[no-untyped-call]


def read_port(
    path: str, writer: Writer, channel: int, lock: threading.Lock, over: threading.Event
) -> None:
    """Read frames until it is over."""
    with serial.Serial(path, 460800, timeout=0.2) as port:
        while not over.is_set():
            frame = port.read_until(b"\0")
            now_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
            if len(frame) > 1:
                with lock:
                    data = STAMPED.pack(now_ns) + frame
                    writer.add_message(channel, time.time_ns(), data, time.time_ns())


if __name__ == "__main__":
    main()
