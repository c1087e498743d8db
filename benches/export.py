#!/usr/bin/env python3
"""Samples out of the database beside pandas doing the same, in one run.

    python3 benches/export.py [--bench PROGRAM]

runs `cargo bench --bench export` (or PROGRAM, a bench that is built already), then Python on the database that it left: the
same columns of the same captures read with `pandas.read_sql_query` and written with `to_parquet` (pyarrow, zstd), `to_csv` and
`to_json(lines=True)`; MCAP with `mcap-ros2-support`, a message with the same fields per sample, of the first tenth. Each figure is that of
reading and writing, as for `vn100d export`, without the start of Python and its imports. The packages go into a virtual
environment of their own, target/peers/export, which is made when it is missing.
"""

import json
import os
import pathlib
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = ROOT / "target" / "peers" / "export"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["pandas", "pyarrow", "mcap==1.*", "mcap-ros2-support==0.*"]
ROUNDS = 3
MCAP_SHARE = 10
TIMES = ["segment_id", "seq", "device_time_ns", "host_utc_ns"]


def main():
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    wanted = "import pandas, pyarrow, mcap_ros2.writer"
    if subprocess.run([PYTHON, "-c", wanted], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    bench = ["cargo", "bench", "--bench", "export"]
    if "--bench" in sys.argv:
        bench = [sys.argv[sys.argv.index("--bench") + 1], "--bench"]
    subprocess.run(bench, cwd=ROOT, env={**os.environ, "EXPORT_DIR": str(HOME)}, check=True)
    subprocess.run([PYTHON, __file__, "--measure"], check=True)


def measure():
    import sqlite3
    import time

    import pandas

    run = json.loads((HOME / "run.json").read_text())
    database = sqlite3.connect(f"file:{HOME / 'vn100d.db'}?mode=ro", uri=True)

    def read(capture, limit=-1):
        columns = ", ".join(TIMES + run["columns"])
        sql = f"SELECT {columns} FROM sample WHERE capture_id = (SELECT id FROM capture WHERE name = ?) ORDER BY seq LIMIT ?"
        frame = pandas.read_sql_query(sql, database, params=(capture, limit))
        frame.insert(0, "time_s", (frame["host_utc_ns"] - frame["host_utc_ns"].iloc[0]) / 1e9)
        return frame

    def parquet(frame, path):
        frame["utc"] = pandas.to_datetime(frame.pop("host_utc_ns"), utc=True)
        frame.to_parquet(path, compression="zstd", row_group_size=262_144)

    def csv(frame, path):
        frame[["time_s", *run["columns"]]].to_csv(path, index=False)

    def ndjson(frame, path):
        frame[["time_s", *run["columns"]]].to_json(path, orient="records", lines=True, double_precision=15)

    def mcap(frame, path):
        from mcap_ros2.writer import Writer

        fields = "".join(f"float64 {column}\n" for column in run["columns"])
        with open(path, "wb") as file, Writer(file) as writer:
            schema = writer.register_msgdef("vn100d_msgs/msg/Sample", f"uint64 seq\n{fields}")
            for row in frame.to_dict("records"):
                ns = row["host_utc_ns"]
                message = {"seq": row["seq"], **{column: row[column] for column in run["columns"]}}
                writer.write_message("/vn100d/sample", schema, message, log_time=ns, publish_time=ns)

    writers = {"parquet": parquet, "csv": csv, "ndjson": ndjson, "mcap": mcap}
    print()
    print(f"{run['samples']} samples, {len(run['columns'])} channels; the same with pandas {pandas.__version__}")
    for row in run["rows"]:
        share = MCAP_SHARE if row["format"] == "mcap" else 1
        path, times = HOME / f"pandas.{row['format']}", []
        for _ in range(1 if share > 1 else ROUNDS):
            begun = time.perf_counter()
            writers[row["format"]](read(row["capture"], run["samples"] // share if share > 1 else -1), path)
            times.append((time.perf_counter() - begun) * share)
        theirs_s, bytes_ = sorted(times)[len(times) // 2], path.stat().st_size * share
        print(
            f"{row['capture']}: {row['format']:<8} {row['s']:>7.3f} s, theirs {theirs_s:>7.3f} s: {theirs_s / row['s']:>6.2f} ×; "
            f"{row['bytes'] / 1e6:>6.1f} MB, theirs {bytes_ / 1e6:>6.1f} MB"
        )


if __name__ == "__main__":
    measure() if "--measure" in sys.argv else main()
