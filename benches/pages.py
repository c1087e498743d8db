#!/usr/bin/env python3
"""How fast pages and pictures are while a sensor is recorded at 800 Hz, and without one, in one run.

    python3 benches/pages.py [PROGRAM]

simulates a five-hour capture at 40 Hz into a database, has the daemon analyse it, and fetches the first page, the capture's page
and its pictures, first beside nothing, then while the daemon records an emulated VN-100 at 800 Hz. PROGRAM is the built program
(default target/release/vn100d). A picture is drawn anew each time (another part of the course is asked for, or no tag is sent);
with its tag it is answered 304.
"""

import http.client
import json
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/release/vn100d").resolve()
MODEL = {
    "format": "vn100d-sensor-model-1",
    "name": "bench",
    "rate_hz": 40,
    "channels": {
        **{f"gyro_{a}": {"N": 1.2e-4, "B": 2.6e-5, "K": 4e-7} for a in "xyz"},
        **{f"accel_{a}": {"N": 1.4e-3, "B": 2e-4, "K": 4e-6} for a in "xyz"},
        **{f"mag_{a}": {"N": 1.4e-4, "B": 2e-5, "K": 4e-7} for a in "xyz"},
        "temperature": {"N": 1e-3, "bias": 30},
    },
}
PICTURES = [
    "timeseries-gyro_x.svg",
    "timeseries-accel_z.png",
    "gaps.svg",
    "histogram-gyro_x.svg",
    "allan-gyro.svg",
    "psd-gyro.svg",
    "hourly-gyro_x.svg",
]


class Daemon:
    def __init__(self, folder, *more):
        command = [PROGRAM, "--data-dir", folder, "run", "--listen", "127.0.0.1:0", *more]
        self.log = open(folder / "log", "a+")
        begun = self.log.tell()
        self.process = subprocess.Popen(command, stderr=self.log, stdout=self.log)
        self.port = None
        deadline = time.monotonic() + 30
        while self.port is None:
            assert time.monotonic() < deadline, "the daemon does not listen"
            time.sleep(0.1)
            text = (folder / "log").read_text()[begun:]
            found = re.search(r"HTTP answers address=127\.0\.0\.1:(\d+)", text)
            self.port = int(found.group(1)) if found else None

    def get(self, path, headers=None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port)
        begun = time.perf_counter()
        connection.request("GET", path, headers=headers or {})
        answer = connection.getresponse()
        body = answer.read()
        return answer, body, 1e3 * (time.perf_counter() - begun)

    def end(self):
        self.process.terminate()
        self.process.wait()


def timed(daemon, path, rounds, headers=None, status=200):
    times = []
    for _ in range(rounds):
        answer, body, ms = daemon.get(path, headers)
        assert answer.status == status, f"{path}: {answer.status} {body[:200]}"
        times.append(ms)
    return answer, len(body), times


def measure(daemon, capture):
    rows = {}

    def note(name, path, rounds, **more):
        answer, size, times = timed(daemon, path, rounds, **more)
        rows[name] = (size, statistics.median(times), max(times))
        return answer

    note("first page", "/", 100)
    note("its live part", "/?part=live", 100)
    note("capture page", f"/captures/{capture}", 10)
    for picture in PICTURES:
        path = f"/v1/captures/{capture}/plots/{picture}"
        tag = note(picture, path, 7).headers["ETag"]
        note(picture + ", its tag known", path, 7, headers={"If-None-Match": tag}, status=304)
    return rows


def main():
    folder = pathlib.Path(tempfile.mkdtemp(prefix="vn100d-pages-"))
    (folder / "model.json").write_text(json.dumps(MODEL))
    subprocess.run(
        [PROGRAM, "--data-dir", folder, "simulate", "--model", folder / "model.json", "--duration", "5h"]
        + ["--rate", "40", "--seed", "1", "--into-db", "night"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    daemon = Daemon(folder, "--device", str(folder / "none"))
    for kind in ["statistics", "allan", "noise"]:
        while daemon.get(f"/v1/captures/night/{kind}")[0].status == 202:
            time.sleep(0.5)
    idle = measure(daemon, "night")
    daemon.end()

    link = folder / "sensor"
    sensor = subprocess.Popen(
        [PROGRAM, "emulate", "--link", link, "--baud", "921600"], stdout=subprocess.DEVNULL
    )
    config = folder / "vn100d.toml"
    config.write_text("[sensor]\nrate-hz = 800.0\nbaud = 921600\n")
    daemon = Daemon(folder, "--device", str(link), "--capture", "1h", "--config", str(config))
    deadline = time.monotonic() + 30
    while True:
        status = json.loads(daemon.get("/v1/status")[1])
        if (status["capture"] or {}).get("samples", 0) > 800:
            break
        assert time.monotonic() < deadline, status
        time.sleep(0.2)
    busy = measure(daemon, "night")
    before = status
    status = json.loads(daemon.get("/v1/status")[1])
    daemon.end()
    sensor.terminate()
    sensor.wait()

    print(f"{'':38} {'bytes':>8} {'alone: median, slowest':>24} {'at 800 Hz':>18} {'ratio':>6}")
    for name, (size, median, slowest) in idle.items():
        _, busy_median, busy_slowest = busy[name]
        print(
            f"{name:38} {busy[name][0]:>8} {median:>12.1f} {slowest:>8.1f} ms {busy_median:>8.1f} {busy_slowest:>6.1f} ms"
            f" {busy_median / median:>6.2f}"
        )
    of = status["capture"]
    print(
        f"meanwhile recorded at {status['sensor']['rate_hz']} Hz: {of['samples'] - before['capture']['samples']} samples, "
        f"{of['missing']} missing, {of['gaps']} gaps"
    )
    subprocess.run(["rm", "-r", folder], check=True)


if __name__ == "__main__":
    main()
