"""Hours of messages, a failing disk among them, in bounded memory.

Row 17 of the fault table in docs/faults.md.
"""

import json
import subprocess
import sys
from pathlib import Path

SOAK = """
import errno, gc, json, sys
from pathlib import Path
from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.messages import ImuRaw
class Dying(Disk):
    dead = False
    def create(self, path):
        if self.dead:
            raise OSError(errno.EROFS, "dead")
        file = super().create(path)
        write = file.write
        def checked(data):
            if self.dead:
                raise OSError(errno.EROFS, "dead")
            return write(data)
        file.write, file.sync = checked, lambda: None
        return file
    def sync_directory(self, folder):
        pass

def rss_kib():
    gc.collect()
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])

out, disk = Path(sys.argv[1]), Dying()
settings = RecorderSettings(part_s=60.0, survives_faults=True, ram_bytes=4 << 20, ram_s=1e9)
recorder = Recorder(False, settings, disk=disk)
own = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
recorder.open(RecordingPlan(out / "a.mcap", {"gyrorig": own}, ()))
k = 0
def run(count):
    global k
    for _ in range(count):
        at = k * 5_000_000
        counts = ((k * 2654435761) & 0xFFFF, k & 0xFFF, -k & 0xFF)
        recorder.put("/board/B-1/imu_raw", ImuRaw(at, k, k & 0xFFFFFFFF, 0, 0, counts), at)
        k += 1
        if k % 50 == 0:
            recorder.tick(at)
        for path in list(recorder.paths[:-2]) if k % 20_000 == 0 else ():
            path.unlink(missing_ok=True)
sizes_kib = []
run(15_000); sizes_kib.append(rss_kib())
run(45_000); sizes_kib.append(rss_kib())
disk.dead = True
run(50_000); sizes_kib.append(rss_kib()); ring = recorder.counts.memory_high_water_bytes
disk.dead = False
run(30_000); sizes_kib.append(rss_kib())
recorder.close()
print(json.dumps({"rss_kib": sizes_kib, "ring": ring, "counts": recorder.counts.values()}))
"""


def test_memory_use_stays_constant(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SOAK, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    warm, healthy, failing, after = document["rss_kib"]
    assert document["counts"]["rotations"] >= 4
    assert document["counts"]["resumes"] == 1
    assert document["ring"] > 1 << 19
    assert healthy - warm < 6 << 10
    # The ring, and what was given back to it because it was not synced.
    assert failing - healthy < (4 << 10) + (6 << 10)
    assert after - healthy < 10 << 10
