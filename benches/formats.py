#!/usr/bin/env python3
"""How fast recordings of each format are read, beside the same samples as CSV, in one run.

    python3 -m venv V && V/bin/pip install numpy scipy h5py pyarrow zstandard
    V/bin/python benches/formats.py --program target/release/vn100d [--rows 1000000]

The same 200 Hz recording of nine channels (ULog and dataflash: six) is written in every form, and `vn100d --json show FILE` is timed, which
reads all of it and accounts for it. The rounds go through all forms in turn; the median of each is printed, and its ratio to CSV's.
Arrow's own reader of CSV and Parquet, and Python's of bzip2 and xz, are timed beside them. An import reads a file twice.
"""

import argparse
import bz2
import gzip
import json
import lzma
import pathlib
import statistics
import struct
import subprocess
import tempfile
import time

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import scipy.io
import zstandard

ROUNDS = 3
NAMES = [f"{triad}_{axis}_{unit}" for triad, unit in (("gyro", "rad_s"), ("accel", "m_s2"), ("mag", "gauss")) for axis in "xyz"]


def write(folder, rows):
    """Writes the files and returns their paths by name."""
    random = np.random.default_rng(5)
    micros = 5000 * np.arange(rows, dtype=np.int64)
    values = np.round(0.01 * random.standard_normal((rows, 9)) + [0, 0, 0, 0, 0, 9.8, 0.2, 0, 0.4], 6)
    table = pa.table({"time_us": micros, **{name: values[:, k] for k, name in enumerate(NAMES)}})
    files = {}

    def path(name, ending):
        files[name] = folder / f"desk.{ending}"
        return files[name]

    pa.csv.write_csv(table, path("CSV", "csv"), pa.csv.WriteOptions(quoting_style="none"))
    text = files["CSV"].read_bytes()
    path("CSV, gzip", "csv.gz").write_bytes(gzip.compress(text, 6))
    path("CSV, bzip2", "csv.bz2").write_bytes(bz2.compress(text))
    path("CSV, xz", "csv.xz").write_bytes(lzma.compress(text, preset=3))
    path("CSV, zstd", "csv.zst").write_bytes(zstandard.compress(text))
    path("CSV, UTF-16", "utf16.csv").write_bytes(b"\xff\xfe" + text.decode().encode("utf-16-le"))
    path("CSV, decimal comma", "comma.csv").write_bytes(text.replace(b",", b";").replace(b".", b","))
    pa.parquet.write_table(table, path("Parquet, Snappy", "parquet"))
    pa.parquet.write_table(table, path("Parquet, zstd", "zstd.parquet"), compression="zstd")
    fields = np.empty(rows, [("time_us", "<i8"), *((name, "<f8") for name in NAMES)])
    fields["time_us"] = micros
    for k, name in enumerate(NAMES):
        fields[name] = values[:, k]
    np.save(path("NumPy, fields", "npy"), fields)
    arrays = {"time_us": micros, "gyro_rad_s": values[:, :3], "accel_m_s2": values[:, 3:6], "mag_gauss": values[:, 6:]}
    np.savez(path("NumPy, npz", "npz"), **arrays)
    scipy.io.savemat(path("MATLAB 5", "mat"), {**arrays, "time_us": micros.astype(float)})
    with h5py.File(path("HDF5", "h5"), "w") as file:
        for name, array in arrays.items():
            file[name] = array
    ulog(path("ULog", "ulg"), micros, values)
    dataflash(path("dataflash", "BIN"), micros, values)
    return files


def ulog(path, micros, values):
    def block(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + block("B", bytes(40))
    head += block("F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;")
    head += block("A", struct.pack("<BH", 0, 1) + b"sensor_combined")
    data = np.empty(len(micros), [("size", "<u2"), ("kind", "u1"), ("id", "<u2"), ("t", "<u8"), ("v", "<f4", 6)])
    data["size"], data["kind"], data["id"], data["t"], data["v"] = data.dtype.itemsize - 3, ord("D"), 1, micros + 1, values[:, :6]
    path.write_bytes(head + data.tobytes())


def dataflash(path, micros, values):
    def form(kind, length, name, letters, columns):
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name, letters, columns)

    head = form(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    data = np.empty(len(micros), [("head", "u1", 3), ("t", "<u8"), ("i", "u1"), ("v", "<f4", 6)])
    head += form(129, data.dtype.itemsize, b"IMU", b"QBffffff", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    data["head"], data["t"], data["i"], data["v"] = (0xA3, 0x95, 129), micros + 1, 0, values[:, :6]
    path.write_bytes(head + data.tobytes())


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--rows", type=int, default=1_000_000)
    arguments = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files = write(pathlib.Path(folder), arguments.rows)
        seconds = {name: [] for name in files}
        own = {"CSV": pa.csv.read_csv, "Parquet, Snappy": pa.parquet.read_table,
               "CSV, bzip2": lambda path: bz2.decompress(path.read_bytes()), "CSV, xz": lambda path: lzma.decompress(path.read_bytes())}
        library = {name: [] for name in own}
        for _ in range(ROUNDS):
            for name, path in files.items():
                begun = time.monotonic()
                shown = subprocess.run([arguments.program, "--json", "show", path], check=True, stdout=subprocess.PIPE).stdout
                seconds[name].append(time.monotonic() - begun)
                found = json.loads(shown)
                assert (found["samples"], found["missing"]) == (arguments.rows, 0), (name, found)
            for name, read in own.items():
                begun = time.monotonic()
                read(files[name])
                library[name].append(time.monotonic() - begun)
        rate = {name: arguments.rows / statistics.median(taken) for name, taken in seconds.items()}
        print("| form | rows/s | of CSV's |\n|---|---|---|")
        for name, found in rate.items():
            print(f"| {name} | {found:,.0f} | {found / rate['CSV']:.2f} |")
        for name, taken in library.items():
            what = "decompressed once by Python" if name in ("CSV, bzip2", "CSV, xz") else "by Arrow"
            print(f"{name} {what}: {arguments.rows / statistics.median(taken):,.0f} rows/s")


main()
