#!/usr/bin/env python3
"""Exported samples read by others: do they find the values, units and times that were recorded?

    cargo build && python3 tests/peers/exports.py [--binary target/debug/vn100d]

A recording with every channel, two holes and absent values becomes a capture, which leaves as MCAP and as Parquet. `mcap` with
`mcap-ros2-support` and `rosbags` decode the messages by the definitions in the file and must come to the recorded values in
SI, bit for bit; `pyarrow` must find the recorded values, the units in the fields' metadata, and the data set's partitions.

The packages go into a virtual environment of their own, target/peers/exports, which is made when it is missing;
`--install` makes it and does no more. Exit code 1 with the first thing that differs.
"""

import argparse
import csv
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
HOME = ROOT / "target" / "peers" / "exports"
PYTHON = HOME / "bin" / "python"
PACKAGES = ["mcap==1.*", "mcap-ros2-support==0.*", "rosbags==0.11.*", "pyarrow"]
IMPORTS = "import mcap.reader, mcap_ros2.decoder, rosbags.highlevel, pyarrow.dataset"

ROWS = 3000
START_NS = 1_795_291_200_000_000_000
COLUMNS = (
    "yaw_deg pitch_deg roll_deg mag_x_gauss mag_y_gauss mag_z_gauss accel_x_m_s2 accel_y_m_s2 accel_z_m_s2 "
    "gyro_x_rad_s gyro_y_rad_s gyro_z_rad_s temperature_c pressure_kpa"
).split()
UNITS = ["deg"] * 3 + ["gauss"] * 3 + ["m/s²"] * 3 + ["rad/s"] * 3 + ["°C", "kPa"]


def install():
    if not PYTHON.exists():
        venv.create(HOME, with_pip=True)
    if subprocess.run([PYTHON, "-c", IMPORTS], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES], check=True)


def recorded():
    """Time in ns and values of each row; None where there is no value."""
    rows, tick = [], 0
    for row in range(ROWS):
        tick += 41 if row == 1000 else 4 if row == 2000 else 1
        x = math.sin(row * 0.1) / 3
        values = [x * 180, x * 60, -x * 90, 0.2 + x / 7, x / 11, -0.4 + x / 13, x / 3, -x / 5, -9.8 + x / 9]
        values += [x / 17, x / 19, -x / 23, 20 + x, 101.3 + x / 29]
        if row % 5 == 0:
            values[12] = None
        if row % 7 == 0:
            values[3:6] = [None] * 3
        if row % 11 == 0:
            values[9:12] = [None] * 3
        rows.append((START_NS + tick * 25_000_000 + row % 1000, values))
    return rows


def write_csv(path, rows):
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time_s", *COLUMNS])
        for ns, values in rows:
            writer.writerow([f"{ns // 10**9}.{ns % 10**9:09}", *("" if v is None else repr(v) for v in values)])


class Check:
    """Counts what agrees and ends where something does not."""

    def __init__(self):
        self.count = 0

    def same(self, what, found, expected):
        both_absent = isinstance(found, float) and math.isnan(found) and expected is None
        if not both_absent and found != expected:
            sys.exit(f"{what}: found {found!r}, expected {expected!r}")
        self.count += 1


def check_message(check, who, topic, message, sequence, rows):
    """One message of whichever reader; `sequence` counts the topic's messages so far."""
    place = sequence[topic]
    sequence[topic] += 1
    wanted = {
        "/imu/data": lambda v: True,
        "/imu/mag": lambda v: v[3] is not None,
        "/imu/temperature": lambda v: v[12] is not None,
        "/imu/pressure": lambda v: True,
        "/vn100d/sample": lambda v: True,
    }[topic]
    if place == 0:
        sequence[topic, "rows"] = [index for index, (_, values) in enumerate(rows) if wanted(values)]
    index = sequence[topic, "rows"][place]
    ns, values = rows[index]
    name = f"{who} {topic} row {index}"
    stamp = message.header.stamp
    check.same(f"{name} stamp", stamp.sec * 10**9 + stamp.nanosec, ns)
    check.same(f"{name} frame", message.header.frame_id, "imu_link")
    xyz = lambda v: [v.x, v.y, v.z]
    if topic == "/imu/data":
        check.same(f"{name} orientation", message.orientation_covariance[0], -1.0)
        check.same(f"{name} acceleration", xyz(message.linear_acceleration), values[6:9])
        absent = values[9] is None
        check.same(f"{name} covariance", message.angular_velocity_covariance[0], -1.0 if absent else 0.0)
        check.same(f"{name} rate", xyz(message.angular_velocity), [0.0] * 3 if absent else values[9:12])
    elif topic == "/imu/mag":
        check.same(f"{name} field", xyz(message.magnetic_field), [v / 1e4 for v in values[3:6]])
    elif topic == "/imu/temperature":
        check.same(name, message.temperature, values[12])
    elif topic == "/imu/pressure":
        check.same(name, message.fluid_pressure, values[13] * 1000)
    else:
        check.same(f"{name} seq", message.seq, index)
        for column, value in zip(COLUMNS, values):
            check.same(f"{name} {column}", getattr(message, column), value)


def check_counts(check, who, sequence, rows):
    absent = lambda place: sum(values[place] is None for _, values in rows)
    expected = {
        "/imu/data": ROWS,
        "/imu/mag": ROWS - absent(3),
        "/imu/temperature": ROWS - absent(12),
        "/imu/pressure": ROWS,
        "/vn100d/sample": ROWS,
    }
    check.same(f"{who} topics", {key: n for key, n in sequence.items() if isinstance(key, str)}, expected)


def check_mcap(check, path, rows):
    from collections import Counter

    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader

    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        check.same("profile", reader.get_header().profile, "ros2")
        statistics = reader.get_summary().statistics
        check.same("first message", statistics.message_start_time, rows[0][0])
        check.same("last message", statistics.message_end_time, rows[-1][0])
        sequence = Counter()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            index = sequence[channel.topic]
            check_message(check, "mcap-ros2-support", channel.topic, decoded, sequence, rows)
            check.same("log time", message.log_time, rows[sequence[channel.topic, "rows"][index]][0])
        check_counts(check, "mcap-ros2-support", sequence, rows)
        check.same("messages", statistics.message_count, sum(n for k, n in sequence.items() if isinstance(k, str)))
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}["vn100d"]
        check.same("missing", metadata["missing"], "43")
    with AnyReader([path]) as reader:
        sequence = Counter()
        for connection, timestamp, data in reader.messages():
            decoded = reader.deserialize(data, connection.msgtype)
            check_message(check, "rosbags", connection.topic, decoded, sequence, rows)
        check_counts(check, "rosbags", sequence, rows)


def check_parquet(check, file, lake, rows):
    import pyarrow.dataset
    import pyarrow.parquet

    for table in [pyarrow.parquet.read_table(file), pyarrow.dataset.dataset(lake, partitioning="hive").to_table()]:
        check.same("rows", table.num_rows, ROWS)
        for column, unit in zip(["time_s", "device_time_ns", *COLUMNS], ["s", "ns", *UNITS]):
            check.same(f"unit of {column}", table.schema.field(column).metadata[b"unit"].decode(), unit)
        check.same("type of utc", str(table.schema.field("utc").type), "timestamp[ns, tz=UTC]")
        check.same("utc", table.column("utc").cast("int64").to_pylist(), [ns for ns, _ in rows])
        check.same("time_s", table.column("time_s").to_pylist(), [(ns - rows[0][0]) / 1e9 for ns, _ in rows])
        check.same("seq", table.column("seq").to_pylist(), list(range(ROWS)))
        check.same("segments", sorted(set(table.column("segment").to_pylist())), [1, 2, 3])
        for place, column in enumerate(COLUMNS):
            check.same(column, table.column(column).to_pylist(), [values[place] for _, values in rows])
    check.same("partitions", sorted(set(table.column("date").to_pylist())), ["2026-11-21"])
    check.same("sensor", sorted(set(table.column("sensor").to_pylist())), ["unknown"])
    metadata = pyarrow.parquet.read_metadata(file).metadata
    check.same("samples", metadata[b"samples"], b"3000")
    check.same("gaps", [gap["missing"] for gap in json.loads(metadata[b"gaps"])], [40, 3])


def measure(binary):
    rows, check = recorded(), Check()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        write_csv(folder / "night.csv", rows)

        def run(*arguments):
            subprocess.run([binary, "--data-dir", folder / "data", *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)

        run("import", "night.csv")
        run("export", "night", "--out", "night.mcap")
        run("export", "night", "--out", "night.parquet")
        run("export", "--all", "--partitioned", "lake")
        check_mcap(check, folder / "night.mcap", rows)
        check_parquet(check, folder / "night.parquet", folder / "lake", rows)
    print(f"{check.count} values, units and times of {ROWS} samples agree (mcap-ros2-support, rosbags, pyarrow)")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", type=pathlib.Path, default=ROOT / "target" / "debug" / "vn100d")
    parser.add_argument("--install", action="store_true")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(arguments.binary.resolve())
        return
    install()
    if not arguments.install:
        ended = subprocess.run([PYTHON, __file__, "--measure", "--binary", arguments.binary], env=os.environ)
        sys.exit(ended.returncode)


if __name__ == "__main__":
    main()
