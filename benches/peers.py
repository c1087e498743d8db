#!/usr/bin/env python3
"""The overlapping Allan deviation beside its peers in one run.

    python3 benches/peers.py

runs `cargo bench --bench peers` (this program, the crates allan-tools and allan, and floors), then allantools from PyPI on
the samples and averaging times that the bench left, and prints one table. allantools goes into a virtual environment of
its own, target/peers, which is made when it is missing.
"""

import json
import os
import pathlib
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = ROOT / "target" / "peers"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["allantools==2024.6"]
ROUNDS = 5


def main():
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    wanted = "import allantools"
    if subprocess.run([PYTHON, "-c", wanted], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    subprocess.run(
        ["cargo", "bench", "--bench", "peers"],
        cwd=ROOT,
        env={**os.environ, "PEERS_DIR": str(HOME)},
        check=True,
    )
    # One thread, as the others.
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    subprocess.run([PYTHON, __file__, "--measure"], env={**os.environ, **one}, check=True)


def measure():
    import time

    import allantools
    import numpy

    run = json.loads((HOME / "run.json").read_text())
    samples = numpy.fromfile(HOME / "samples.f64")
    times = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        taus, deviation, _, _ = allantools.oadev(samples, rate=1.0, data_type="freq", taus=run["factors"])
        times.append(time.process_time() - begun)
    time_ms = 1e3 * sorted(times)[len(times) // 2]
    if [round(tau) for tau in taus] != run["factors"]:
        sys.exit("allantools left averaging times out")
    apart = max(abs(theirs / ours - 1) for theirs, ours in zip(deviation, run["deviation"]))
    if apart > 1e-6:
        sys.exit(f"allantools comes to other deviations: apart by {apart:.0e}")
    print()
    print(f"{len(samples)} samples, {len(taus)} averaging times, one thread, this run")
    name = f"allantools {allantools.__version__} (NumPy {numpy.__version__})"
    for row in [*run["rows"], {"name": name, "ms": time_ms}]:
        print(f"{row['name']:<44} {row['ms']:>9.2f} ms  {row['ms'] / run['ours_ms']:>7.2f} ×")
    print(f"allantools' deviations and these are apart by {apart:.0e}")


if __name__ == "__main__":
    measure() if "--measure" in sys.argv else main()
