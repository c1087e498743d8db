#!/usr/bin/env python3
"""Reads the live data of a running vn100d as an independent client, and measures how late it arrives.

    python3 tests/peers/share.py --program target/release/vn100d --seconds 60

It starts an emulated sensor at 800 Hz and a daemon that records and shares it. The copy of the port is opened with
pyserial, or as a plain file where pyserial is missing. This script finds and checks the binary frames by itself, by the
VN-100's documentation: sync byte, groups, fields, CRC-16. Latency is the time from the emulator's write (its log) to the
return of the read here, both on the host's clock CLOCK_BOOTTIME; frames are matched by the sensor's time.
"""

import argparse
import json
import os
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

SYNC, GROUPS, FIELDS = 0xFA, 0x01, 0x0609
# TimeStartup; yaw, pitch, roll; acceleration and angular rate; magnetic field, temperature, pressure.
PAYLOAD = struct.Struct("<Q3f6f5f")
FRAME_BYTES = 4 + PAYLOAD.size + 2
PORT = 8377


def now_ns():
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def crc16(data):
    crc = 0
    for byte in data:
        crc = ((crc >> 8) | (crc << 8)) & 0xFFFF
        crc ^= byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= (crc << 12) & 0xFFFF
        crc ^= (crc & 0xFF) << 5
    return crc & 0xFFFF


class Frames:
    """Frames out of bytes; bytes of no frame are counted."""

    def __init__(self):
        self.buffer, self.found, self.bad, self.last = b"", [], 0, None

    def push(self, data, arrived_ns):
        self.buffer += data
        while len(self.buffer) >= FRAME_BYTES:
            frame = self.buffer[:FRAME_BYTES]
            if frame[0] == SYNC and frame[1] == GROUPS and frame[2] | frame[3] << 8 == FIELDS and crc16(frame[1:]) == 0:
                self.last = PAYLOAD.unpack(frame[4:-2])
                self.found.append((self.last[0], arrived_ns))
                self.buffer = self.buffer[FRAME_BYTES:]
            else:
                # Before the first frame stand the replies to the daemon's own commands.
                self.bad += 1 if self.found else 0
                self.buffer = self.buffer[1:]


def read_copy(path, stop, frames):
    try:
        import serial

        port = serial.Serial(path, 921600, timeout=0)
        read, fd = (lambda: port.read(4096)), port.fileno()
    except ImportError:
        fd = os.open(path, os.O_RDONLY | os.O_NOCTTY)
        read = lambda: os.read(fd, 4096)
    import select

    while not stop.is_set():
        if select.select([fd], [], [], 0.2)[0]:
            data = read()
            frames.push(data, now_ns())


def read_socket(path, stop, frames):
    client = socket.socket(socket.AF_UNIX)
    client.connect(path)
    client.settimeout(0.2)
    buffer = b""
    while not stop.is_set():
        try:
            buffer += client.recv(65536)
        except TimeoutError:
            continue
        arrived_ns = now_ns()
        *lines, buffer = buffer.split(b"\n")
        for line in lines:
            sample = json.loads(line)
            if "device_time_s" in sample:
                frames.found.append((round(sample["device_time_s"] * 1e9), arrived_ns))
                frames.last = tuple(sample.values())
            else:
                frames.bad += 1


def wait_for(what, condition):
    for _ in range(400):
        try:
            found = condition()
            if found:
                return found
        except OSError:
            pass
        time.sleep(0.05)
    sys.exit(f"{what}: not within 20 s")


def get(route):
    with urllib.request.urlopen(f"http://127.0.0.1:{PORT}{route}") as answer:
        return json.load(answer)


def summary(frames, logged):
    times = [device_ns for device_ns, _ in frames.found]
    steps = [later - earlier for earlier, later in zip(times, times[1:])]
    late = sorted((arrived - logged[device_ns]) / 1e6 for device_ns, arrived in frames.found if device_ns in logged)
    return {
        "frames": len(times),
        "bad": frames.bad,
        "not_logged": sum(device_ns not in logged for device_ns in times),
        "skipped": sum(step > 1_500_000 for step in steps),
        "median_ms": round(statistics.median(late), 3),
        "p99_ms": round(late[int(0.99 * (len(late) - 1))], 3),
        "max_ms": round(late[-1], 3),
        "last": frames.last,
    }


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--program", default="target/release/vn100d")
    options.add_argument("--seconds", type=float, default=20)
    options.add_argument("--json", action="store_true")
    options = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        at = lambda name: os.path.join(folder, name)
        with open(at("share.toml"), "w") as config:
            config.write("[sensor]\nbaud = 921600\nrate-hz = 800.0\n")
            config.write(f'[share]\nlink = "{at("tty")}"\nsocket = "{at("imu.sock")}"\n')
        emulate = [options.program, "emulate", "--baud", "921600", "--link", at("sensor"), "--log", at("log")]
        run = [options.program, "--data-dir", at("data"), "--config", at("share.toml"), "run"]
        run += ["--listen", f"127.0.0.1:{PORT}", "--device", at("sensor"), "--capture", "1h"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        children = [subprocess.Popen(emulate, **quiet)]
        try:
            wait_for("the sensor", lambda: os.path.exists(at("sensor")))
            children.append(subprocess.Popen(run, **quiet))
            wait_for("samples", lambda: (get("/v1/status")["capture"] or {}).get("samples", 0) > 800)
            wait_for("link and socket", lambda: os.path.exists(at("tty")) and os.path.exists(at("imu.sock")))
            stop, copy, lines = threading.Event(), Frames(), Frames()
            readers = [
                threading.Thread(target=read_copy, args=(at("tty"), stop, copy)),
                threading.Thread(target=read_socket, args=(at("imu.sock"), stop, lines)),
            ]
            [reader.start() for reader in readers]
            time.sleep(options.seconds)
            stop.set()
            [reader.join() for reader in readers]
            status = get("/v1/status")
            # The log's last lines are written soon after the frames.
            time.sleep(0.3)
            with open(at("log")) as log:
                rows = [line.split() for line in log if line[0] not in "#!" and line.endswith("\n")]
            logged = {int(row[2]): int(row[3]) for row in rows}
        finally:
            for child in reversed(children):
                child.terminate()
                child.wait()
    found = {"copy": summary(copy, logged), "socket": summary(lines, logged)}
    found |= {"samples": status["capture"]["samples"], "missing": status["capture"]["missing"], "share": status["share"]}
    if options.json:
        print(json.dumps(found))
        return
    for way in ["copy", "socket"]:
        of = found[way]
        print(f"{way}: {of['frames']} frames, {of['bad']} bad, {of['skipped']} skipped; latency median", end=" ")
        print(f"{of['median_ms']} ms, 99 % {of['p99_ms']} ms, most {of['max_ms']} ms")
    print(f"copy, last frame: {['%.6g' % value for value in copy.last]}")
    print(f"recorder: {found['samples']} samples, {found['missing']} missing")


main()
