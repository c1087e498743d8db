#!/usr/bin/env python3
"""A simulation beside NumPy doing the same, in one run.

    python3 benches/simulator.py

runs `cargo bench --bench simulator` and NumPy in turn, at 40 Hz and at 800 Hz, and prints times, memory and their ratios.
NumPy does it as it is usually made to: white noise, flicker shaped by FFT over the whole record, a cumulative sum; nine
channels, one process, a channel's whole record in memory. It goes into a virtual environment of its own, target/peers,
which is made when it is missing. `--bench PROGRAM` takes a bench that is built already.
"""

import os
import pathlib
import re
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = ROOT / "target" / "peers"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["numpy"]
ROUNDS = 3
RATES_HZ = (40, 800)
LENGTH_S = 18_000
CHANNELS = 9
N, B, K = 1.2e-4, 2.6e-5, 1.5e-6
ROW = re.compile(r"^(?P<name>.+?) +(?P<threads>\d+) threads: +(?P<time>[\d.]+) s, +(?P<work>[\d.]+) s of processor, +(?P<memory>[\d.]+) MB")


def main():
    bench = ["cargo", "bench", "--bench", "simulator"]
    if "--bench" in sys.argv:
        bench = [sys.argv[sys.argv.index("--bench") + 1]]
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    if subprocess.run([PYTHON, "-c", "import numpy"], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    # One thread, as each of ours; in turn, so that what else the machine does meets both.
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    runs = {}
    for _ in range(ROUNDS):
        for row in map(ROW.match, told(bench).splitlines()):
            if row:
                key = (row["name"], f"{row['threads']} thread(s)")
                runs.setdefault(key, []).append(tuple(float(row[of]) for of in ("work", "time", "memory")))
        for rate_hz in RATES_HZ:
            words = told([PYTHON, __file__, "--measure", str(rate_hz)], {**os.environ, **one}).split()
            runs.setdefault((f"5 h at {rate_hz} Hz", f"NumPy {words[3]}"), []).append(tuple(map(float, words[:3])))
    middle = {key: sorted(runs)[len(runs) // 2] for key, runs in runs.items()}
    print(f"{CHANNELS} channels with N, B and K; medians of {ROUNDS} runs by processor time; × one thread of this program")
    print("memory: the heap of this program, all of NumPy's process")
    for (name, who), (work_s, time_s, memory_mb) in sorted(middle.items()):
        times = work_s / middle[name, "1 thread(s)"][0]
        print(f"{name:<31} {who:<13} {time_s:>6.2f} s, processor {work_s:>6.2f} s {times:>5.2f} × {memory_mb:>6.1f} MB")


def told(command, environment=None):
    return subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


def measure(rate_hz):
    import resource
    import time

    import numpy as np

    def channel(rng, count):
        white = N * np.sqrt(rate_hz) * rng.standard_normal(count)
        spectrum = np.fft.rfft(rng.standard_normal(count))
        frequency = np.fft.rfftfreq(count, 1 / rate_hz)
        frequency[0] = frequency[1]
        # Two-sided density B²/(2πf) of samples at rate_hz.
        flicker = np.fft.irfft(spectrum * B * np.sqrt(rate_hz / (2 * np.pi * frequency)), count)
        walk = K / np.sqrt(rate_hz) * np.cumsum(rng.standard_normal(count))
        return white + flicker + walk

    rng = np.random.default_rng(1)
    begun, begun_work = time.perf_counter(), time.process_time()
    for _ in range(CHANNELS):
        channel(rng, int(LENGTH_S * rate_hz))
    took_s, work_s = time.perf_counter() - begun, time.process_time() - begun_work
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(work_s, took_s, peak_mb, np.__version__)


if __name__ == "__main__":
    measure(float(sys.argv[sys.argv.index("--measure") + 1])) if "--measure" in sys.argv else main()
