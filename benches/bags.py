#!/usr/bin/env python3
"""Reading ROS recordings beside rosbags, in one run.

    python3 benches/bags.py

has rosbags (from PyPI) write a ROS 1 bag, a ROS 2 .db3 and an MCAP file with the same 200,000 sensor_msgs/Imu messages, runs
`cargo bench --bench bags` on them, then reads them with rosbags, which takes every message apart as that program's users do,
and prints one table. rosbags goes into a virtual environment of its own, target/peers, which is made when it is missing.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
HOME = ROOT / "target" / "peers"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["rosbags==0.11.9"]
BAGS = HOME / "bags"
MESSAGES = 200_000
ROUNDS = 3


def main():
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    wanted = "import rosbags.highlevel, rosbags.rosbag2"
    if subprocess.run([PYTHON, "-c", wanted], stderr=subprocess.DEVNULL).returncode != 0:
        subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    subprocess.run([PYTHON, __file__, "--make"], check=True)
    subprocess.run(
        ["cargo", "bench", "--bench", "bags"],
        cwd=ROOT,
        env={**os.environ, "BAGS_DIR": str(BAGS)},
        check=True,
    )
    subprocess.run([PYTHON, __file__, "--measure"], check=True)


def message(types, imu_of, time_of, index):
    """The same values in both generations of ROS."""
    import numpy

    vector = types["geometry_msgs/msg/Vector3"]
    zeros = numpy.zeros(9)
    gyro = vector(x=1e-3 * (index % 7), y=-2e-3 * (index % 5), z=1e-4)
    accel = vector(x=0.1, y=-0.2, z=9.8 + 1e-3 * (index % 3))
    turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return imu_of(time_of(index), turned, zeros, gyro, accel)


def stamp_ns(index):
    return 1_700_000_000_000_000_000 + 5_000_000 * index


def make():
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    shutil.rmtree(BAGS, ignore_errors=True)
    BAGS.mkdir(parents=True)
    old, new = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)

    def imu(store, **more):
        types = store.types

        def of(stamp, turned, zeros, gyro, accel):
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **more)
            return types["sensor_msgs/msg/Imu"](
                header=header,
                orientation=turned,
                orientation_covariance=zeros,
                angular_velocity=gyro,
                angular_velocity_covariance=zeros,
                linear_acceleration=accel,
                linear_acceleration_covariance=zeros,
            )

        def time(index):
            seconds, nanos = divmod(stamp_ns(index), 10**9)
            return types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanos)

        return lambda index: message(types, of, time, index)

    bag = Writer1(BAGS / "imu.bag")
    bag.set_compression(Writer1.CompressionFormat.LZ4)
    with bag:
        topic = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=old)
        of = imu(old, seq=0)
        for index in range(MESSAGES):
            bag.write(topic, stamp_ns(index), old.serialize_ros1(of(index), "sensor_msgs/msg/Imu"))
    of = imu(new)
    for plugin, ending in [(StoragePlugin.SQLITE3, "db3"), (StoragePlugin.MCAP, "mcap")]:
        with Writer2(BAGS / ending, version=9, storage_plugin=plugin) as bag:
            topic = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=new)
            for index in range(MESSAGES):
                bag.write(topic, stamp_ns(index), new.serialize_cdr(of(index), "sensor_msgs/msg/Imu"))
        shutil.copy(BAGS / ending / f"{ending}.{ending}", BAGS / f"imu.{ending}")


def measure():
    import time

    from importlib.metadata import version

    from rosbags.highlevel import AnyReader

    ours = {row["file"]: row for row in json.loads((BAGS / "run.json").read_text())}
    print()
    print(f"{MESSAGES} messages, this run; processor time and messages a second of it")
    for file, path in [("imu.bag", "imu.bag"), ("imu.db3", "db3"), ("imu.mcap", "mcap")]:
        times = []
        for _ in range(ROUNDS):
            begun, count, total = time.process_time(), 0, 0.0
            with AnyReader([BAGS / path]) as reader:
                for connection, _, data in reader.messages():
                    read = reader.deserialize(data, connection.msgtype)
                    total += read.angular_velocity.x + read.linear_acceleration.z
                    count += 1
            times.append(time.process_time() - begun)
        row = ours[file]
        if count != MESSAGES or row["samples"] != MESSAGES:
            sys.exit(f"{file}: rosbags read {count} messages, vn100d {row['samples']}")
        theirs_s, ours_s = sorted(times)[len(times) // 2], row["processor_s"]
        for name, seconds in [("vn100d, read twice and accounted for", ours_s), (f"rosbags {version('rosbags')}", theirs_s)]:
            rate = MESSAGES / seconds
            print(f"{file:<9} {name:<38} {1e3 * seconds:>8.0f} ms {rate:>10.0f} /s {seconds / ours_s:>6.1f} ×")


if __name__ == "__main__":
    if "--make" in sys.argv:
        make()
    elif "--measure" in sys.argv:
        measure()
    else:
        main()
