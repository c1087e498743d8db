#!/usr/bin/env python3
"""Writes the recordings of crates/imu-files/tests/recordings with the libraries of their formats, and expected.json.

    python3 -m venv V && V/bin/pip install numpy scipy h5py pyarrow pandas pyulog pymavlink rosbags zstandard
    V/bin/python tests/peers/recordings.py

One made-up movement is written in every form: 120 grid points at 200 Hz of which three are missing. expected.json holds its
values in the channels' units, and for each file what a reader must find. Nothing of vn100d is used. A form whose library only
reads (pymavlink, pyulog's reader) is written here after its specification and read back by that library as a check.
Deterministic: the same libraries write the same bytes (archives get a fixed time).
"""

import bz2
import gzip
import io
import json
import lzma
import pathlib
import shutil
import struct
import tempfile
import zipfile

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
import zstandard
from pymavlink import DFReader
from pyulog import ULog

OUT = pathlib.Path(__file__).resolve().parents[2] / "crates/imu-files/tests/recordings"
RATE_HZ, POINTS, LOST = 200.0, 120, (50, 51, 52)
G, START_NS = 9.80665, 1_710_358_267_000_000_000
AXES = "xyz"

index = np.array([i for i in range(POINTS) if i not in LOST])
nanos = (index * 5_000_000).astype(np.int64)
t = nanos / 1e9
random = np.random.default_rng(27)
grid = np.arange(POINTS)


def triad(centre, swing, noise):
    waves = [c + swing * np.sin(2 * np.pi * (k + 1) * grid / 60.0) for k, c in enumerate(centre)]
    return np.round(np.array(waves) + noise * random.standard_normal((3, POINTS)), 6)[:, index]


gyro = triad((0.01, -0.02, 0.03), 0.2, 0.001)
accel = triad((0.11, -0.22, 9.79), 0.05, 0.01)
mag = triad((0.2, -0.05, 0.42), 0.02, 0.001)
temperature = np.round(25 + 0.01 * index, 4)
pressure = np.round(101.3 + 0.001 * index, 4)
TRUTH = {f"{name}_{axis}": list(values[k]) for name, values in (("gyro", gyro), ("accel", accel), ("mag", mag))
         for k, axis in enumerate(AXES)}
TRUTH |= {"temperature": list(temperature), "pressure": list(pressure)}
ANGLES = ["yaw", "pitch", "roll"]
TRUTH |= {name: [0.0] * len(index) for name in ANGLES}
IMU = [f"{name}_{axis}" for name in ("gyro", "accel") for axis in AXES]
GYRO, ACCEL, MAG = IMU[:3], IMU[3:], [f"mag_{axis}" for axis in AXES]

expected = []


def expect(file, channels, *, within=1e-9, unix=False, columns="", rate=None, conversions=None, refused=None, gap=True,
           samples=None):
    """States what a reader must find in `file`: `within` is relative to the channel's largest value."""
    expected.append({"samples": samples or len(t),
        "file": file, "channels": channels, "within": within, "unix": unix, "columns": columns, "rate": rate,
        "conversions": conversions or {}, "refused": refused, "missing": 3 if gap and not samples else 0,
    })


def write(name, content):
    path = OUT / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def frame(columns):
    return pd.DataFrame({name: values for name, values in columns})


def csv_of(columns, **options):
    return frame(columns).to_csv(index=False, **options)


def named(names, values, factor=1.0, digits=9):
    return [(name, np.round(value * factor, digits)) for name, value in zip(names, values)]


def texts():
    ns = nanos + START_NS
    euroc = [("#timestamp [ns]", ns), *named([f"w_RS_S_{a} [rad s^-1]" for a in AXES], gyro),
             *named([f"a_RS_S_{a} [m s^-2]" for a in AXES], accel)]
    write("euroc.csv", csv_of(euroc, lineterminator="\r\n"))
    expect("euroc.csv", IMU, unix=True)
    # TUM-VI writes the same columns and ends lines with a line feed alone.
    write("tum_vi.csv", csv_of(euroc))
    expect("tum_vi.csv", IMU, unix=True)
    write("phyphox_gyroscope.csv", csv_of([("Time (s)", t), *named([f"Gyroscope {a} (rad/s)" for a in AXES], gyro),
                                           ("Absolute (rad/s)", np.linalg.norm(gyro, axis=0))], quoting=2))
    expect("phyphox_gyroscope.csv", GYRO)
    phyphox = [("Time (s)", t), *named([f"Acceleration {a} (m/s^2)" for a in AXES], accel),
               ("Absolute acceleration (m/s^2)", np.linalg.norm(accel, axis=0))]
    write("phyphox_accelerometer_comma.csv", csv_of(phyphox, sep=";", decimal=","))
    expect("phyphox_accelerometer_comma.csv", ACCEL)
    write("phyphox_accelerometer_tab.csv", csv_of(phyphox, sep="\t", float_format="%.9E"))
    expect("phyphox_accelerometer_tab.csv", ACCEL, within=1e-8)
    write("phyphox_magnetometer.csv", csv_of([("Time (s)", t), *named([f"Magnetic field {a} (µT)" for a in AXES], mag, 100),
                                              ("Absolute field (µT)", 100 * np.linalg.norm(mag, axis=0))]))
    expect("phyphox_magnetometer.csv", MAG, conversions={"mag_x": "µT"})
    logger = [("time", ns), ("seconds_elapsed", t), *list(reversed(named(AXES, accel)))]
    write("TotalAcceleration.csv", csv_of(logger))
    pairs = "time=time_ns,x=accel_x_m_s2,y=accel_y_m_s2,z=accel_z_m_s2"
    expect("TotalAcceleration.csv", [], refused=f"--columns '{pairs}'")
    expect("TotalAcceleration.csv", ACCEL, unix=True, columns=pairs)
    write("Gyroscope.csv", csv_of([("time", ns), ("seconds_elapsed", t), *list(reversed(named(AXES, gyro)))]))
    expect("Gyroscope.csv", [], refused="--columns 'time=time_ns,x=gyro_x_rad_s,y=gyro_y_rad_s,z=gyro_z_rad_s'")
    secs, nsecs, zero = ns // 10**9, ns % 10**9, np.zeros(len(ns), int)
    message = [*[(f"orientation.{a}", zero) for a in "xyzw"], ("orientation_covariance_0", zero),
               *named([f"angular_velocity.{a}" for a in AXES], gyro), ("angular_velocity_covariance_0", zero),
               *named([f"linear_acceleration.{a}" for a in AXES], accel), ("linear_acceleration_covariance_0", zero)]
    write("bagpy.csv", csv_of([("Time", np.round(ns / 1e9, 6)), ("header.seq", index), ("header.stamp.secs", secs),
                               ("header.stamp.nsecs", nsecs), ("header.frame_id", ["imu"] * len(ns)), *message]))
    expect("bagpy.csv", IMU, unix=True)
    late = ns + random.integers(0, 900_000, len(ns))
    write("rostopic_echo.csv", csv_of([("%time", late), ("field.header.seq", index), ("field.header.stamp", ns),
                                       ("field.header.frame_id", ["imu"] * len(ns)),
                                       *[(f"field.{name}".replace("_covariance_", "_covariance"), v) for name, v in message]]))
    expect("rostopic_echo.csv", IMU, unix=True)
    write("rostopic_echo_mag.csv", csv_of([("%time", ns), ("field.header.seq", index), ("field.header.stamp", ns),
                                           *named([f"field.magnetic_field.{a}" for a in AXES], mag, 1e-4, 12)]))
    expect("rostopic_echo_mag.csv", MAG, unix=True, conversions={"mag_x": "T"})
    slashed = [(f"/imu/data/{name}".replace(".", "/"), v) for name, v in message]
    write("plotjuggler.csv", csv_of([("__time", [f"{s}.{n:09}" for s, n in zip(secs, nsecs)]),
                                     ("/imu/data/header/stamp", ns / 1e9), *slashed]))
    expect("plotjuggler.csv", IMU, unix=True)
    write("vectornav_fields.csv", csv_of([
        ("Time::TimeStartup [ns]", nanos), ("IMU::ImuStatus", zero),
        *named([f"IMU::UncompGyro::{a.upper()} [rad/s]" for a in AXES], gyro + 1),
        ("IMU::Temp [Celsius]", temperature), ("IMU::Pres [kPa]", pressure),
        *named([f"IMU::DeltaTheta::{a.upper()} [deg]" for a in AXES], gyro),
        *named([f"IMU::Mag::{a.upper()} [Gauss]" for a in AXES], mag),
        *named([f"IMU::Accel::{a.upper()} [m/s^2]" for a in AXES], accel),
        *named([f"IMU::AngularRate::{a.upper()} [rad/s]" for a in AXES], gyro)]))
    expect("vectornav_fields.csv", [*IMU, *MAG, "temperature", "pressure"])
    plain = [("Time [ms]", t * 1e3), *named([f"Gyro_{a.upper()} [rad/s]" for a in AXES], gyro),
             *named([f"ACC {a} (m/s²)" for a in AXES], accel)]
    write("plain_units.csv", csv_of(plain))
    expect("plain_units.csv", IMU)
    write("pandas_index.csv", frame(plain).to_csv())
    expect("pandas_index.csv", IMU)
    write("semicolon_comma.csv", csv_of(plain, sep=";", decimal=",").encode("utf-8-sig").replace(b"\n", b"\r\n"))
    expect("semicolon_comma.csv", IMU)
    for name, encoding in (("utf16_le.csv", "utf-16"), ("utf16_be.csv", "utf-16-be")):
        text = csv_of(plain[:4], sep="\t")
        write(name, ("\ufeff" + text if encoding == "utf-16-be" else text).encode(encoding))
        expect(name, GYRO)
    write("dates.csv", csv_of([("timestamp", pd.to_datetime(ns, utc=True).strftime("%Y-%m-%dT%H:%M:%S.%fZ")), *plain[1:]]))
    expect("dates.csv", IMU, unix=True)
    write("epoch_ms.csv", csv_of([("timestamp", ns // 10**6), *plain[1:]]))
    expect("epoch_ms.csv", IMU, unix=True)
    write("unknown_time.csv", csv_of([("t", nanos // 1000), *plain[1:]]))
    expect("unknown_time.csv", [], refused="--columns 't=time_us'")
    write("small_units.csv", csv_of([
        ("time_us", nanos // 1000), *named([f"g{a} [deg/h]" for a in AXES], np.degrees(gyro), 3600),
        *named([f"a{a} [mg]" for a in AXES], accel, 1e3 / G), *named([f"m{a} [nT]" for a in AXES], mag, 1e5)]))
    expect("small_units.csv", [*IMU, *MAG], within=1e-7, conversions={"gyro_x": "deg/h", "accel_x": "mg", "mag_x": "nT"})
    write("other_units.csv", csv_of([
        ("TIMESTAMP (us)", nanos // 1000), *named([f"GYRO_{a.upper()} (MDPS)" for a in AXES], np.degrees(gyro), 1e3),
        *named([f"Accelerometer {a} [g]" for a in AXES], accel, 1 / G),
        *named([f"Mag {a} (mG)" for a in AXES], mag, 1e3), ("Baro press [hPa]", pressure * 10)]))
    expect("other_units.csv", [*IMU, *MAG, "pressure"], within=1e-7,
           conversions={"gyro_x": "mdps", "accel_x": "g", "mag_x": "mgauss", "pressure": "hPa"})
    write("impossible_unit.csv", csv_of([("time_s", t), *named([f"gyro_{a} [m/s^2]" for a in AXES], gyro)]))
    expect("impossible_unit.csv", [], refused="names a channel with its unit")
    parts = [("stamp_s", secs), ("stamp_rest", nsecs), *named(["p", "q", "r"], gyro)]
    write("parts.csv", csv_of(parts))
    expect("parts.csv", GYRO, unix=True,
           columns="stamp_s=time_secs,stamp_rest=time_nsecs,p=gyro_x_rad_s,q=gyro_y_rad_s,r=gyro_z_rad_s")


def compressed():
    text = csv_of([("time_s", t), *named([f"gyro_{a}_rad_s" for a in AXES], gyro),
                   *named([f"accel_{a}_m_s2" for a in AXES], accel)]).encode()
    write("plain.csv.gz", gzip.compress(text, mtime=0))
    write("plain.csv.bz2", bz2.compress(text))
    write("plain.csv.xz", lzma.compress(text))
    write("plain.csv.zst", zstandard.ZstdCompressor().compress(text))
    for end in ("gz", "bz2", "xz", "zst"):
        expect(f"plain.csv.{end}", IMU)


def numeric():
    table = np.column_stack([nanos // 1000, *accel, *gyro])
    text = io.BytesIO()
    np.savetxt(text, table, fmt="%.6f")
    write("savetxt.txt", text.getvalue())
    pairs = ("#1=time_us,#2=accel_x_m_s2,#3=accel_y_m_s2,#4=accel_z_m_s2,#5=gyro_x_rad_s,#6=gyro_y_rad_s,#7=gyro_z_rad_s")
    expect("savetxt.txt", [], refused=f"--columns '{pairs}'")
    expect("savetxt.txt", IMU, columns=pairs)
    text = io.BytesIO()
    np.savetxt(text, table[:, 1:], fmt="%12.6f", header="accel_x_m_s2 accel_y_m_s2 accel_z_m_s2 gyro_x_rad_s gyro_y_rad_s gyro_z_rad_s")
    write("savetxt_header.txt", text.getvalue())
    expect("savetxt_header.txt", IMU, rate=200.0, gap=False)
    oxts = np.zeros((len(t), 30))
    oxts[:, 11:14], oxts[:, 17:20], oxts[:, 0] = accel.T, gyro.T, 49.0
    dates = pd.to_datetime(nanos + START_NS).strftime("%Y-%m-%d %H:%M:%S.%f") + "000"
    write("kitti/oxts/timestamps.txt", "".join(f"{date}\n" for date in dates[:20]))
    for k, row in enumerate(oxts[:20]):
        write(f"kitti/oxts/data/{k:010}.txt", " ".join(f"{value:.6f}".rstrip("0").rstrip(".") for value in row) + "\n")
    expected.append({"file": "kitti/oxts", "channels": [*IMU, *ANGLES], "within": 1e-9, "unix": True, "columns": "", "rate": None,
                     "conversions": {"roll": "rad"}, "refused": None, "missing": 0, "samples": 20})
    np.save(OUT / "table.npy", table)
    expect("table.npy", [], refused=f"--columns '{pairs}'")
    expect("table.npy", IMU, columns=pairs)
    np.save(OUT / "fortran.npy", np.asfortranarray(table.astype(">f4")))
    expect("fortran.npy", IMU, columns=pairs, within=1e-6)
    fields = [("time_s", "<f8"), *[(f"gyro_{a}_rad_s", "<f4") for a in AXES], ("status", "u1"),
              *[(f"accel_{a}_m_s2", "<f4") for a in AXES]]
    rows = np.zeros(len(t), dtype=fields)
    rows["time_s"] = t
    for k, a in enumerate(AXES):
        rows[f"gyro_{a}_rad_s"], rows[f"accel_{a}_m_s2"] = gyro[k], accel[k]
    np.save(OUT / "structured.npy", rows)
    expect("structured.npy", IMU, within=1e-6)
    arrays = {"time_s": t, "gyro_rad_s": gyro.T, "accel_m_s2": accel.T, "rate": np.array(RATE_HZ)}
    np.savez(OUT / "arrays.npz", **arrays)
    expect("arrays.npz", IMU)
    np.savez_compressed(OUT / "arrays_compressed.npz", time_us=nanos // 1000, gyro_dps=np.degrees(gyro.T), accel_g=accel.T / G)
    expect("arrays_compressed.npz", IMU, conversions={"gyro_x": "deg/s", "accel_x": "g"})


def columnar():
    flat = frame([("timestamp [ns]", nanos + START_NS), *named([f"gyro_{a} [rad/s]" for a in AXES], gyro),
                  *named([f"accel_{a} [m/s^2]" for a in AXES], accel)])
    flat.to_parquet(OUT / "pandas.parquet")
    expect("pandas.parquet", IMU, unix=True)
    dated = frame([("time", pd.to_datetime(nanos + START_NS, utc=True)), *named([f"gyro_{a}_dps" for a in AXES], np.degrees(gyro))])
    pq.write_table(pa.Table.from_pandas(dated), OUT / "dates_zstd.parquet", compression="zstd", row_group_size=50)
    expect("dates_zstd.parquet", GYRO, unix=True, conversions={"gyro_x": "deg/s"})
    floats = pa.table({"time_us": nanos // 1000, **{f"gyro_{a}_rad_s": pa.array(gyro[k].astype("f4")) for k, a in enumerate(AXES)}})
    pq.write_table(floats, OUT / "gzip.parquet", compression="gzip")
    expect("gzip.parquet", GYRO, within=1e-6)


def matlab():
    column = lambda values: np.asarray(values).reshape(-1, 1)
    flat = {"time_s": column(t), "gyro_rad_s": gyro.T, "accel_m_s2": accel.T, "note": "made up"}
    scipy.io.savemat(OUT / "matlab5.mat", flat)
    scipy.io.savemat(OUT / "matlab5_compressed.mat", flat, do_compression=True)
    nested = {"imu": {"time_us": column(nanos // 1000), "gyro_dps": np.degrees(gyro.T), "accel_g": (accel.T / G).astype("f4")}}
    scipy.io.savemat(OUT / "matlab5_struct.mat", nested)
    expect("matlab5.mat", IMU)
    expect("matlab5_compressed.mat", IMU)
    expect("matlab5_struct.mat", IMU, within=1e-6, conversions={"gyro_x": "deg/s", "accel_x": "g"})
    for path in ("matlab5.mat", "matlab5_compressed.mat", "matlab5_struct.mat"):
        # The date in the header.
        content = bytearray((OUT / path).read_bytes())
        content[:116] = b"MATLAB 5.0 MAT-file Platform: posix, Created on: Fri Jan  1 00:00:00 2027".ljust(116)
        (OUT / path).write_bytes(content)
    with h5py.File(OUT / "matlab73.mat", "w", userblock_size=512, libver="earliest") as file:
        for name, values in (("time_s", t.reshape(1, -1)), ("gyro_rad_s", gyro), ("accel_m_s2", accel)):
            # MATLAB's dimensions are those of HDF5 in reverse.
            file.create_dataset(name, data=values, chunks=values.shape, compression="gzip").attrs["MATLAB_class"] = np.bytes_("double")
    with open(OUT / "matlab73.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Fri Jan  1 00:00:00 2027 HDF5 schema 1.00 .".ljust(116))
        file.write(struct.pack("<QHH", 0, 0x0200, 0x4D49))
    expect("matlab73.mat", IMU)
    with h5py.File(OUT / "groups.h5", "w") as file:
        group = file.create_group("imu0")
        group["timestamp_ns"] = nanos + START_NS
        group.create_dataset("gyro_rad_s", data=gyro.T, chunks=(40, 3), compression="gzip", shuffle=True)
        group.create_dataset("accel_m_s2", data=accel.T.astype("f4"))
    expect("groups.h5", IMU, within=1e-6, unix=True)


def ulog():
    def block(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000) + block("B", bytes(40))
    info = b"char[5] sys_name"
    head += block("I", bytes([len(info)]) + info + b"PX4v1")
    head += block("F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
                  b"int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;"
                  b"uint8_t accelerometer_clipping;uint8_t[3] _padding0;")
    head += block("F", b"vehicle_status:uint64_t timestamp;uint8_t arming_state;uint8_t[7] _padding0;")
    body = block("A", struct.pack("<BH", 0, 0) + b"vehicle_status") + block("A", struct.pack("<BH", 0, 1) + b"sensor_combined")
    for k, ns in enumerate(nanos):
        us = 1_000_000 + ns // 1000
        if k % 40 == 0:
            body += block("D", struct.pack("<HQB", 0, us, 1))
        body += block("D", struct.pack("<HQ3fIi3fIB", 1, us, *gyro[:, k], 5000, 0, *accel[:, k], 5000, 0))
    raw = OUT / "px4.ulg"
    raw.write_bytes(head + body)
    log = ULog(str(raw))
    data = log.get_dataset("sensor_combined").data
    assert np.allclose(data["gyro_rad[1]"], gyro[1]) and len(data["timestamp"]) == len(t)
    log.write_ulog(str(raw))
    expect("px4.ulg", IMU, within=1e-6)
    from pyulog.ulog2csv import convert_ulog2csv
    with tempfile.TemporaryDirectory() as folder:
        convert_ulog2csv(str(raw), "sensor_combined", folder, ",", None, None)
        shutil.copy(next(pathlib.Path(folder).glob("*sensor_combined_0.csv")), OUT / "ulog2csv.csv")
    expect("ulog2csv.csv", IMU, within=1e-6)


def dataflash():
    lengths = {"B": 1, "H": 2, "I": 4, "Q": 8, "f": 4, "n": 4, "N": 16, "Z": 64, "i": 4, "h": 2, "b": 1, "d": 8, "M": 1}

    def message(kind, body):
        return struct.pack("<BBB", 0xA3, 0x95, kind) + body

    def declare(kind, name, form, labels):
        size = 3 + sum(lengths[c] for c in form)
        return message(128, struct.pack("<BB4s16s64s", kind, size, name, form.encode(), labels.encode()))
    out = message(128, struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"))
    out += declare(129, b"IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz")
    out += declare(130, b"VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip")
    for k, ns in enumerate(nanos):
        us = 5_000_000 + ns // 1000
        for instance, shift in ((0, 0.0), (1, 0.5)):
            out += message(129, struct.pack("<QB6fIIfBBHH", us, instance, *(gyro[:, k] + shift), *accel[:, k], 0, 0,
                                            temperature[k], 1, 1, 2000, 2000))
        if k % 20 == 0:
            out += message(130, struct.pack("<QBfffI", us, 0, 1.0, 2.0, 3.0, 0))
    (OUT / "ardupilot.bin").write_bytes(out)
    log = DFReader.DFReader_binary(str(OUT / "ardupilot.bin"))
    read = [m for m in iter(lambda: log.recv_match(type="IMU"), None) if m.I == 0]
    assert len(read) == len(t) and abs(read[7].GyrY - gyro[1, 7]) < 1e-6
    expect("ardupilot.bin", [*IMU, "temperature"], within=1e-6)


def ros():
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    common = ("std_msgs/Header header\nuint64 timestartup\ngeometry_msgs/Vector3 yawpitchroll\ngeometry_msgs/Vector3 imu_accel\n"
              "geometry_msgs/Vector3 imu_rate\ngeometry_msgs/Vector3 magpres_mag\nfloat32 magpres_temp\nfloat32 magpres_pres\n")
    group = ("std_msgs/Header header\ngeometry_msgs/Vector3 uncompgyro\nfloat32 temp\nfloat32 pres\ngeometry_msgs/Vector3 mag\n"
             "geometry_msgs/Vector3 accel\ngeometry_msgs/Vector3 angularrate\n")
    odd = "std_msgs/Header header\nlab_msgs/Part left\n"
    part = "float64 p\nfloat64 q\nfloat64 r\n"
    store = get_typestore(Stores.ROS2_HUMBLE)
    for text, name in ((common, "vectornav_msgs/msg/CommonGroup"), (group, "vectornav_msgs/msg/ImuGroup"),
                       (part, "lab_msgs/msg/Part"), (odd, "lab_msgs/msg/Odd")):
        store.register(get_types_from_msg(text, name))
    types = store.types
    vector = lambda values: types["geometry_msgs/msg/Vector3"](*map(float, values))
    header = lambda ns: types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](int(ns // 10**9), int(ns % 10**9)), "imu")

    BAG_SAMPLES = 45

    def bag(name, topic, kind, make, plugin):
        path = OUT / name
        shutil.rmtree(path, ignore_errors=True)
        with Writer2(path, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, ns in enumerate(nanos[:BAG_SAMPLES] + START_NS):
                writer.write(connection, int(ns), store.serialize_cdr(make(k, ns), kind))
    imu = types["sensor_msgs/msg/Imu"]
    quaternion = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    bag("bag_folder", "/imu", "sensor_msgs/msg/Imu", lambda k, ns: imu(
        header(ns), quaternion, np.zeros(9), vector(gyro[:, k]), np.zeros(9), vector(accel[:, k]), np.zeros(9)), StoragePlugin.MCAP)
    expect("bag_folder", samples=BAG_SAMPLES, channels=IMU, unix=True)
    bag("common_group", "/vectornav/raw/common", "vectornav_msgs/msg/CommonGroup", lambda k, ns: types["vectornav_msgs/msg/CommonGroup"](
        header(ns), int(ns), vector([0, 0, 0]), vector(accel[:, k]), vector(gyro[:, k]), vector(mag[:, k]),
        float(temperature[k]), float(pressure[k])), StoragePlugin.MCAP)
    expect("common_group", samples=BAG_SAMPLES, channels=[*IMU, *MAG, *ANGLES, "temperature", "pressure"], unix=True, within=1e-6)
    bag("imu_group", "/vectornav/raw/imu", "vectornav_msgs/msg/ImuGroup", lambda k, ns: types["vectornav_msgs/msg/ImuGroup"](
        header(ns), vector(gyro[:, k] + 1), float(temperature[k]), float(pressure[k]), vector(mag[:, k]), vector(accel[:, k]),
        vector(gyro[:, k])), StoragePlugin.MCAP)
    expect("imu_group", samples=BAG_SAMPLES, channels=[*IMU, *MAG, "temperature", "pressure"], unix=True, within=1e-6)
    bag("odd_message", "/odd", "lab_msgs/msg/Odd", lambda k, ns: types["lab_msgs/msg/Odd"](
        header(ns), types["lab_msgs/msg/Part"](*map(float, np.degrees(gyro[:, k])))), StoragePlugin.MCAP)
    expect("odd_message", samples=BAG_SAMPLES, channels=GYRO, unix=True, columns="left.p=gyro_x_dps,left.q=gyro_y_dps,left.r=gyro_z_dps",
           conversions={"gyro_x": "deg/s"})


def main():
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    for part in (texts, compressed, numeric, columnar, matlab, ulog, dataflash, ros):
        part()
    lines = ",\n".join(json.dumps(entry, ensure_ascii=False, separators=(",", ":")) for entry in expected)
    truth = json.dumps({name: [float(v) for v in values] for name, values in TRUTH.items()}, separators=(",", ":"))
    write("expected.json", f'{{"rate_hz": {RATE_HZ}, "start_ns": {START_NS}, "samples": {len(t)},\n"truth": {truth},\n"files": [\n{lines}\n]}}\n')
    sizes = {path.name: path.stat().st_size for path in OUT.rglob("*") if path.is_file()}
    print(len(expected), "expectations,", len(sizes), "files,", sum(sizes.values()), "bytes; the largest:",
          sorted(sizes.items(), key=lambda item: -item[1])[:6])


main()
