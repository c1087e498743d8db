#!/usr/bin/env python3
"""A data set of more than a hundred captures, read by DuckDB, DataFusion and Spark, beside the daemon's own results.

    python3 tests/scale/run.py [--captures 104] [--program target/release/vn100d]

Makes captures with the program (simulated nights, recordings with holes, one from an emulated sensor whose cable is pulled),
exports them as a partitioned Parquet folder, lets each engine compute partial sums of the overlapping Allan variance, and
checks: the engines' sums are the same integers; sums of parts, added, give each capture's deviation as `vn100d allan` tells
it, to 1e-12, with the same number of terms; captures added give what `vn100d allan` tells of several at once. Packages come
from PyPI into target/scale/venv; Spark needs Java 17 or later (Debian: default-jre-headless). Fails with the first difference.
"""

import argparse
import collections
import csv
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import time
import venv

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
HOME = ROOT / "target" / "scale"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["duckdb==2.0.0", "datafusion==55.0.0", "pyarrow==26.0.1", "pyspark==4.3.0"]
ENGINES = ["duckdb", "datafusion", "spark"]
SEED = 20261122
RATE_HZ = 40
# How the names of simulated captures and of imported ones begin.
SIMULATED, IMPORTED = "night", "holes"
# Of the deviations, relative: the last digits of a square root.
WITHIN = 1e-12


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--captures", type=int, default=104)
    parser.add_argument("--minutes", type=int, default=15)
    parser.add_argument("--program", type=pathlib.Path)
    options = parser.parse_args()
    program = options.program
    if program is None:
        subprocess.run(["cargo", "build", "--release"], cwd=ROOT, check=True)
        program = ROOT / "target" / "release" / "vn100d"
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    work = HOME / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    vn100d = Program(program.resolve(), work / "data")
    make(vn100d, work, options.captures, options.minutes)
    folder = work / "data-set"
    begun = time.monotonic()
    vn100d.run("export", "--all", "--partitioned", folder)
    captures = {capture["id"]: capture for capture in vn100d.json("captures")["captures"]}
    files = list(folder.glob("sensor=*/date=*/capture-*.parquet"))
    check(len(files) == len(captures), f"{len(files)} files for {len(captures)} captures")
    size = sum(file.stat().st_size for file in files)
    print(f"{len(files)} captures exported: {size / 1e6:.0f} MB in {time.monotonic() - begun:.1f} s")

    sums = {}
    for engine in ENGINES:
        print(f"== {engine}")
        out = work / f"{engine}.csv"
        begun = time.monotonic()
        status, memory_mb = run_measured([PYTHON, HERE / "engines.py", engine, folder, out])
        check(status == 0, f"{engine} failed")
        print(f"{time.monotonic() - begun:.1f} s with its start, at most {memory_mb:.0f} MB resident")
        sums[engine] = read(out)
    first = sums[ENGINES[0]]
    for engine in ENGINES[1:]:
        check(sums[engine] == first, f"{engine} and {ENGINES[0]} come to different sums")
    print(f"== {len(first)} partial sums, the same integers from {', '.join(ENGINES)}")
    compare(vn100d, first, captures)


def compare(vn100d, parts, captures):
    """The sums of parts, and of captures, beside what the program says."""
    sys.path.insert(0, str(HERE))
    from engines import SCALES
    from partial_sums import LARGEST, deviation

    # Captures of different sensors are not analysed together: the simulated ones are of one.
    together = {capture for capture, row in captures.items() if row["name"].startswith(SIMULATED)}
    whole, pooled = collections.Counter(), collections.Counter()
    for (channel, capture, _, m), (terms, largest, squares) in parts.items():
        check(largest <= LARGEST, f"capture {capture}, m = {m}: a difference of {largest} steps")
        for of, key in [(whole, (channel, capture, m)), (pooled, (channel, m))]:
            if of is whole or capture in together:
                of[key, "terms"] += terms
                of[key, "squares"] += squares
    counted, farthest = 0, 0.0

    def beside(curves, key_of):
        nonlocal counted, farthest
        for channel, scale in SCALES.items():
            curve = curves["channels"][channel]
            for tau_s, expected, n in zip(curve["tau_s"], curve["deviation"], curve["n"]):
                m = round(tau_s * curves["rate_hz"])
                key, of = key_of(channel, m)
                terms = of[key, "terms"]
                check(terms == n, f"{key}: {terms} terms, the program has {n}")
                apart = abs(deviation(terms, of[key, "squares"], scale, m) / expected - 1)
                check(apart <= WITHIN, f"{key}: apart by {apart:.1e}")
                farthest, counted = max(farthest, apart), counted + 1

    for capture in captures:
        curves = vn100d.json("allan", capture, "--taus", "octave", "--format", "json")
        beside(curves, lambda channel, m: ((channel, capture, m), whole))
    print(f"{counted} deviations of {len(captures)} captures: the same terms, farthest apart {farthest:.1e}")
    before = counted
    curves = vn100d.json("allan", *together, "--taus", "octave", "--format", "json")
    beside(curves, lambda channel, m: ((channel, m), pooled))
    print(f"{counted - before} deviations of {len(together)} captures together: farthest apart {farthest:.1e}")


def make(vn100d, work, captures, minutes):
    """Simulated captures, each of its own seed; recordings with holes; one through a terminal, with a loss."""
    chance = random.Random(SEED)
    holed = 8
    for index in range(captures - holed - 2):
        vn100d.run("simulate", "--duration", f"{minutes}m", "--seed", index, "--into-db", f"{SIMULATED}-{index}")
    vn100d.run("simulate", "--duration", "5h", "--seed", SEED, "--into-db", f"{SIMULATED}-long")
    for index in range(holed):
        whole, cut = work / "whole.csv", work / f"{IMPORTED}-{index}.csv"
        vn100d.run("simulate", "--duration", f"{minutes}m", "--seed", 1000 + index, "--out", whole, "--force")
        lines = whole.read_text().splitlines(keepends=True)
        for _ in range(5):
            begin = chance.randrange(100, len(lines) - 3000)
            del lines[begin : begin + chance.choice([1, 2, 40, 2400])]
        cut.write_text("".join(lines))
        vn100d.run("import", cut)
    link = work / "sensor"
    speed = ["--speed", "50"]
    faults = work / "faults"
    faults.write_text("".join(f"{at_s}s unplug 10s\n" for at_s in range(100, 60 * minutes, 100)))
    emulator = vn100d.start("emulate", "--link", link, "--faults", faults, *speed)
    daemon = None
    try:
        until(link.exists, "the emulated sensor")
        daemon = vn100d.start("run", "--device", link, "--capture", f"{minutes}m", "--listen", "127.0.0.1:0", *speed)

        def of_sensor():
            rows = vn100d.json("captures")["captures"] if (vn100d.data / "vn100d.db").exists() else []
            return next((row for row in rows if not row["name"].startswith((SIMULATED, IMPORTED))), None)

        until(lambda: (of_sensor() or {}).get("state") == "complete", "the end of the sensor's capture")
        row = of_sensor()
        print("of the emulated sensor:", {key: row[key] for key in ("samples", "missing", "state")})
        check(row["missing"] > 0, "the unplugged sensor lost nothing")
    finally:
        for process in filter(None, [daemon, emulator]):
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60)


class Program:
    """The program under test, on a database of its own."""

    def __init__(self, path, data):
        self.path, self.data = path, data

    def arguments(self, arguments):
        return [self.path, "--data-dir", self.data, *map(str, arguments)]

    def run(self, *arguments):
        done = subprocess.run(self.arguments(arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        check(done.returncode in (0, 3), f"{arguments}: exit code {done.returncode}: {done.stderr}")
        return done.stdout

    def json(self, *arguments):
        return json.loads(self.run(*arguments, "--json"))

    def start(self, *arguments):
        quiet = (self.data.parent / f"{arguments[0]}.log").open("w")
        return subprocess.Popen(self.arguments(arguments), stdout=quiet, stderr=quiet)


def until(condition, what):
    deadline = time.monotonic() + 120
    while not condition():
        check(time.monotonic() < deadline, f"{what} did not come")
        time.sleep(0.2)


def run_measured(command):
    """Exit status, and the most memory that it and what it started had resident, MB."""
    process = subprocess.Popen(list(map(str, command)), env={**os.environ, "OMP_NUM_THREADS": "2"})
    most_kb = 0
    while process.poll() is None:
        most_kb = max(most_kb, tree_kb(process.pid))
        time.sleep(0.1)
    return process.returncode, most_kb / 1000


def tree_kb(pid):
    """Resident memory of a process and its descendants."""
    total = 0
    for process in [pid, *descendants(pid)]:
        try:
            status = pathlib.Path(f"/proc/{process}/status").read_text()
        except OSError:
            continue
        total += next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")), 0)
    return total


def descendants(pid):
    found = []
    for task in pathlib.Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = task.read_text().split()
        except OSError:
            continue
        for child in map(int, children):
            found += [child, *descendants(child)]
    return found


def read(file):
    with open(file, newline="") as lines:
        return {
            (row["channel"], int(row["capture"]), int(row["part"]), int(row["m"])): tuple(
                int(row[name]) for name in ("terms", "largest", "squares")
            )
            for row in csv.DictReader(lines)
        }


def check(holds, otherwise):
    if not holds:
        sys.exit(f"FAILED: {otherwise}")


if __name__ == "__main__":
    main()
