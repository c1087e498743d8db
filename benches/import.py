#!/usr/bin/env python3
"""An import beside pandas doing the same, in one run.

    python3 benches/import.py

runs `cargo bench --bench import`, then pandas on the file that the bench left: `read_csv` (its C parser, and pyarrow's where
that is there), and `to_sql` into SQLite with the usual chunks, synced as ours. It goes into a virtual environment of its own,
target/peers, which is made when it is missing. `--bench PROGRAM` takes a bench that is built already.
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
PACKAGES = ["pandas"]
ROUNDS = 3
CHUNK = 50_000
ROW = re.compile(r"^(?P<name>[^:]+(?:: [^:]+)?): +(?P<rows>\d+) rows/s")


def main():
    bench = ["cargo", "bench", "--bench", "import"]
    if "--bench" in sys.argv:
        bench = [sys.argv[sys.argv.index("--bench") + 1], "--bench"]
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    if subprocess.run([PYTHON, "-c", "import pandas"], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    environment = {**os.environ, "IMPORT_DIR": str(HOME)}
    ours = subprocess.run(bench, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    print(ours, end="")
    # One thread, as each pass of ours; an import of ours has a second one that writes.
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    theirs = subprocess.run([PYTHON, __file__, "--measure"], env={**os.environ, **one}, check=True, stdout=subprocess.PIPE, text=True).stdout
    print(theirs, end="")
    rows = {match["name"]: float(match["rows"]) for match in map(ROW.match, (ours + theirs).splitlines()) if match}
    for name, peer in [
        ("parse: values and times", "pandas read_csv"),
        ("parse: rate, channels, findings", "pandas read_csv"),
        ("import into SQLite", "pandas read_csv + to_sql"),
    ]:
        print(f"{name}: {rows[name] / rows[peer]:.2f} × {peer}")


def measure():
    import sqlite3
    import tempfile
    import time

    import pandas

    file = HOME / "import.csv"
    parse, whole = [], []
    for _ in range(ROUNDS):
        begun = time.perf_counter()
        table = pandas.read_csv(file)
        parse.append(time.perf_counter() - begun)
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            database = sqlite3.connect(pathlib.Path(folder) / "peer.db")
            database.execute("PRAGMA journal_mode = WAL")
            database.execute("PRAGMA synchronous = FULL")
            pandas.read_csv(file).to_sql("sample", database, index=False, chunksize=CHUNK)
            database.close()
            whole.append(time.perf_counter() - begun)
    count = len(table)
    for name, times in [("pandas read_csv", parse), ("pandas read_csv + to_sql", whole)]:
        took = sorted(times)[len(times) // 2]
        print(f"{name}: {count / took:>9.0f} rows/s ({count} in {took:.3f} s, pandas {pandas.__version__})")


if __name__ == "__main__":
    measure() if "--measure" in sys.argv else main()
