#!/usr/bin/env python3
"""`vn100d cost` beside an implementation of its own in numpy: do both grow errors alike?

    cargo build --release && python3 tests/peers/cost.py [--binary target/release/vn100d]

Here the weights of the samples are listed one by one, and a variance is a double sum over them and the noise's
covariance or structure function in the time domain. `vn100d` integrates spectra in closed form instead; nothing is
shared but the definition of docs/cost.md. N, B, K, a tone, a ramp and a Gauss-Markov process, each on the gyroscope and the
accelerometer, at twelve horizons from 1 s to an hour: the check fails (exit code 1) if a number differs by more than 1 %.

Along a motion the sensor's samples are made here from the laws of docs/effects.md. Truth and samples are integrated in small
steps of each period, where `vn100d` has closed forms. The standard deviations of N and K follow from the change of each
error by each sample, one at a time. Means may differ by 1 % of the largest of their quantity, standard deviations by five
standard errors of 500 runs. Needs numpy alone.
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
RATE_HZ, ALIGN_S, GRAVITY = 40.0, 30.0, 9.80665
HORIZONS_S = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 3600]
WITHIN = 0.01
EULER_GAMMA = 0.57721566490153286
TONE = {"effect": "tone", "frequency_hz": 0.0173, "amplitude": 1e-3}
MARKOV = {"effect": "gauss_markov", "sigma": 3e-4, "tc_s": 20}
RAMP = {"effect": "rate_ramp", "R": 1e-7}
CHANNELS = {
    "N": {"N": 1e-4},
    "B": {"B": 3e-5},
    "K": {"K": 2e-6},
    "tone": {"effects": [TONE]},
    "ramp": {"effects": [RAMP]},
    "Gauss-Markov": {"effects": [MARKOV]},
}


def weights(order, horizon_s):
    """Integral of the order of samples that hold over their period, less the mean over the alignment."""
    count, align = round(horizon_s * RATE_HZ), round(ALIGN_S * RATE_HZ)
    left = np.arange(count, -1, -1) / RATE_HZ
    power = left**order / math.factorial(order)
    return np.concatenate([np.full(align, -power[0] / align), power[:-1] - power[1:]])


def correlation(one):
    """Sum over j of w_j w_(j+k), for k from 0 up."""
    size = 1 << (2 * len(one) - 1).bit_length()
    spectrum = np.fft.rfft(one, size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(one)]


def cin(lags):
    """The integral of (1 - cos t)/t from 0 to pi k, for whole k."""
    x = np.pi * np.maximum(lags, 1)
    # For multiples of pi the cosine integral is -cos(x) times the auxiliary function g.
    g = (1 - 6 / x**2 + 120 / x**4 - 5040 / x**6) / x**2
    values = EULER_GAMMA + np.log(x) + np.where(lags % 2 == 0, 1, -1) * g
    for k in range(1, 8):
        t = (np.arange(200_000) + 0.5) * np.pi * k / 200_000
        values[lags == k] = np.mean((1 - np.cos(t)) / t) * np.pi * k
    values[lags == 0] = 0
    return values


def moments(name, w):
    """Mean and variance of the sum of weighted samples."""
    lags = np.arange(len(w))
    time_s = lags / RATE_HZ
    if name == "N":
        return 0, CHANNELS[name]["N"] ** 2 * RATE_HZ * np.sum(w * w)
    if name == "K":
        # The step after sample k moves all later ones.
        later = np.cumsum(w[::-1])[::-1][1:]
        return 0, CHANNELS[name]["K"] ** 2 / RATE_HZ * np.sum(later * later)
    if name == "tone":
        wave = np.exp(2j * np.pi * TONE["frequency_hz"] * time_s)
        return 0, 0.5 * TONE["amplitude"] ** 2 * abs(np.sum(w * wave)) ** 2
    if name == "ramp":
        return RAMP["R"] * np.sum(w * time_s), 0
    if name == "Gauss-Markov":
        covariance = MARKOV["sigma"] ** 2 * np.exp(-time_s / MARKOV["tc_s"])
    else:
        # Minus half the mean square difference serves as a covariance, since the weights sum to 0.
        covariance = -CHANNELS[name]["B"] ** 2 / np.pi * cin(lags)
    both = correlation(w)
    return 0, both[0] * covariance[0] + 2 * np.sum(both[1:] * covariance[1:])


def expected(name):
    """Mean and standard deviation of each quantity at each horizon; the channels are independent."""
    parts = {
        "heading": [(1, 1)],
        "attitude_x": [(1, 1)],
        "velocity_x": [(1, 1), (2, GRAVITY)],
        "velocity_y": [(1, 1), (2, -GRAVITY)],
        "position_x": [(2, 1), (3, GRAVITY)],
        "position_y": [(2, 1), (3, -GRAVITY)],
    }
    by_order = {o: [moments(name, weights(o, h)) for h in HORIZONS_S] for o in (1, 2, 3)}
    for quantity, of in parts.items():
        mean = [sum(f * by_order[o][i][0] for o, f in of) for i in range(len(HORIZONS_S))]
        variance = [sum(f * f * by_order[o][i][1] for o, f in of) for i in range(len(HORIZONS_S))]
        yield quantity, mean, [math.sqrt(v) for v in variance]


def found(binary, name):
    channels = {f"{triad}_{axis}": CHANNELS[name] for triad in ("gyro", "accel") for axis in "xyz"}
    model = {"format": "vn100d-sensor-model-1", "name": name, "rate_hz": RATE_HZ, "channels": channels}
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump(model, file)
        file.flush()
        horizons = ",".join(f"{h}s" for h in HORIZONS_S)
        command = [binary, "cost", "--model", file.name, "--align", f"{ALIGN_S}s", "--horizons", horizons, "--json"]
        return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["quantities"]


MOTION_S, MOTION_ALIGN_S, PARTS = 30, 10, 16
MOTION_HORIZONS_S = [2, 5, 10, 20, 30]
RUNS_ERROR = 1 / math.sqrt(2 * 500)
QUANTITIES = ["attitude_x", "attitude_y", "heading", "velocity_x", "velocity_y", "position_x", "position_y"]
M = [[1e-5, 0, 2e-5], [0, -1e-5, 1e-5], [2e-5, 0, 3e-5]]
TRIADS = {
    "scale_factor": {"x": 1e-3, "y": -2e-3, "z": 3e-3},
    "misalignment": {"x": 2e-3, "y": -1e-3, "z": 1e-3},
    "cross_axis_sensitivity": {"xy": 1e-3, "xz": -2e-3, "yz": 1e-3},
    "scale_factor_nonlinearity": {"x": 1e-3, "y": 1e-3, "z": -1e-3, "full_scale": 10, "form": "unsigned"},
    "latency": {"seconds": 0.1},
    "g_sensitivity": {"m": M},
}


def exponential(turn):
    """Rotation matrices of rotation vectors, by Rodrigues' formula."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(turn, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    near = np.where(angle > 1e-8, angle, 1)
    sine = np.where(angle > 1e-8, np.sin(near) / near, 1)
    cosine = np.where(angle > 1e-8, (1 - np.cos(near)) / near**2, 0.5)
    return np.eye(3) + sine * cross + cosine * (cross @ cross)


def motion():
    """Rates and specific forces of a sensor that turns and accelerates, level and at rest in the first second."""
    time_s = np.arange(round(MOTION_S * RATE_HZ) + 1) / RATE_HZ
    t = np.maximum(time_s - 1, 0)
    begins = 1 - np.exp(-(t**2))
    roll, pitch, yaw = 0.6 * begins * np.sin(0.9 * t), 0.4 * begins * np.sin(0.5 * t), 0.7 * begins * t
    axis = lambda angle, k: exponential(angle[:, None] * np.eye(3)[k])
    attitude = axis(yaw, 2) @ axis(pitch, 1) @ axis(roll, 0)
    step = np.swapaxes(attitude[:-1], 1, 2) @ attitude[1:]
    rate = vector(step) * RATE_HZ
    world = np.stack([2 * begins * np.sin(0.4 * t), begins * np.cos(0.7 * t), 0.5 * begins * np.sin(t)], -1)
    force = np.einsum("kji,kj->ki", attitude, world + [0, 0, GRAVITY])[:-1]
    return rate, force


def vector(rotation):
    """Rotation vectors of rotation matrices, for less than half a turn."""
    part = lambda i, j: rotation[..., i, j] - rotation[..., j, i]
    twice = np.stack([part(2, 1), part(0, 2), part(1, 0)], -1)
    sine = np.linalg.norm(twice, axis=-1, keepdims=True) / 2
    cosine = (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1) / 2
    angle = np.arctan2(sine, cosine)
    return twice / 2 * np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1), 1)


def integrate(rate, force, parts):
    """Attitude, velocity and position at the horizons, for samples (…, time, axis) that hold over their period."""
    shape = rate.shape[:-2]
    attitude, velocity, position = np.broadcast_to(np.eye(3), shape + (3, 3)), np.zeros(shape + (3,)), np.zeros(shape + (3,))
    dt, found = 1 / RATE_HZ / parts, []
    for k in range(rate.shape[-2]):
        whole, half = exponential(rate[..., k, :] * dt), exponential(rate[..., k, :] * dt / 2)
        for _ in range(parts):
            gain = np.einsum("...ij,...j->...i", attitude @ half, force[..., k, :]) * dt
            position = position + velocity * dt + gain * dt / 2
            velocity = velocity + gain
            attitude = attitude @ whole
        if (k + 1) / RATE_HZ in MOTION_HORIZONS_S:
            found.append((attitude, velocity, position))
    return found


def differences(found, truth):
    """Errors (…, horizon, quantity)."""
    rows = []
    for (attitude, velocity, position), (own, v, p) in zip(found, truth):
        angle = vector(attitude @ own.T)
        rows.append(np.concatenate([angle, (velocity - v)[..., :2], (position - p)[..., :2]], -1))
    return np.stack(rows, -2)


def sensed(true, force, effects):
    """What a triad shows of a motion, by the laws of docs/effects.md, less the alignment's error."""
    rest = round(MOTION_ALIGN_S * RATE_HZ)
    begin = lambda of: np.concatenate([np.repeat(of[:1], rest, 0), of])
    inputs, felt = begin(true), begin(force)
    if "latency" in effects:
        late = round(TRIADS["latency"]["seconds"] * RATE_HZ)
        inputs, felt = (np.concatenate([np.repeat(of[:1], late, 0), of[:-late]]) for of in (inputs, felt))
    out = inputs.copy()
    if "misalignment" in effects:
        out += np.cross([TRIADS["misalignment"][axis] for axis in "xyz"], inputs)
    if "cross_axis_sensitivity" in effects:
        of = TRIADS["cross_axis_sensitivity"]
        out += inputs @ np.array([[0, of["xy"], of["xz"]], [of["xy"], 0, of["yz"]], [of["xz"], of["yz"], 0]])
    crossed = out.copy()
    if "scale_factor" in effects:
        out += crossed * [TRIADS["scale_factor"][axis] for axis in "xyz"]
    if "scale_factor_nonlinearity" in effects:
        of = TRIADS["scale_factor_nonlinearity"]
        out += crossed**2 / of["full_scale"] * [of[axis] for axis in "xyz"]
    if "g_sensitivity" in effects:
        out += felt @ np.array(M).T
    return out[rest:] - (out - begin(true))[:rest].mean(0)


def along(binary, folder, gyro, accel, noise):
    """The cost of a model along the motion, by `vn100d`."""
    name = lambda effects: {"effects": [{"effect": of, **TRIADS[of]} for of in effects]}
    channels = {f"{triad}_{axis}": of for triad, of in zip(("gyro", "accel"), noise) for axis in "xyz"}
    model = {"format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": RATE_HZ, "channels": channels}
    model["triads"] = {"gyro": name(gyro), "accel": name(accel)}
    (folder / "unit.json").write_text(json.dumps(model))
    horizons = ",".join(f"{h}s" for h in MOTION_HORIZONS_S)
    command = [binary, "cost", "--model", folder / "unit.json", "--motion", folder / "motion.csv"]
    command += ["--align", f"{MOTION_ALIGN_S}s", "--horizons", horizons, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["quantities"]


def motion_means(binary, folder, rate, force):
    """Prints the largest deviation of means along the motion; returns it."""
    print("\n| along a motion | largest deviation of means |\n|---|---|")
    truth, worst = integrate(rate, force, PARTS), 0
    both = [name for name in TRIADS if name != "g_sensitivity"]
    cases = [(f"{name} of the gyroscope", [name], []) for name in TRIADS]
    cases += [(f"{name} of the accelerometer", [], [name]) for name in both] + [("all of them", list(TRIADS), both)]
    for name, gyro, accel in cases:
        found = integrate(sensed(rate, force, gyro), sensed(force, force, accel), PARTS)
        peer = differences(found, truth)
        ours = along(binary, folder, gyro, accel, ({}, {}))
        own = np.stack([ours[quantity]["mean"] for quantity in QUANTITIES], -1)
        scale = np.abs(peer).max(0)
        off = np.max(np.abs(own - peer)[:, scale > 1e-9] / scale[scale > 1e-9])
        print(f"| {name} | {off:.0e} |")
        worst = max(worst, off)
    return worst


def motion_noise(binary, folder, rate, force):
    """Prints the deviations of standard deviations along the motion in standard errors; returns the largest."""
    print("\n| along a motion | root mean square deviation of sd | largest, in standard errors |\n|---|---|---|")
    count, align = len(rate), round(MOTION_ALIGN_S * RATE_HZ)
    truth, worst = integrate(rate, force, 1), 0
    size = 1e-6
    changes = []
    for channel in range(6):
        samples = [np.broadcast_to(of, (count, count, 3)).copy() for of in (rate, force)]
        samples[channel // 3][np.arange(count), np.arange(count), channel % 3] += size
        own = differences(integrate(*samples, 1), truth) / size
        changes.append(np.concatenate([np.broadcast_to(-own.sum(0) / align, (align,) + own.shape[1:]), own]))
    for key, gyro, accel in (("N", 1e-4, 2e-3), ("K", 1e-5, 1e-4)):
        variance = 0
        for channel, w in enumerate(changes):
            if key == "N":
                gathered, scale = w, RATE_HZ
            else:
                gathered, scale = np.cumsum(w[::-1], 0)[::-1][1:], 1 / RATE_HZ
            variance = variance + (gyro, accel)[channel // 3] ** 2 * scale * np.sum(gathered**2, 0)
        ours = along(binary, folder, [], [], ({key: gyro}, {key: accel}))
        own = np.stack([ours[quantity]["sd"] for quantity in QUANTITIES], -1)
        off = own / np.sqrt(variance) - 1
        largest = np.max(np.abs(off)) / RUNS_ERROR
        print(f"| {key} | {100 * math.sqrt(np.mean(off**2)):.1f} % | {largest:.1f} |")
        worst = max(worst, largest)
    return worst


def motion_check(binary):
    """Compares along a motion; exits if the deviations are too large."""
    rate, force = motion()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        header = ["time_s"] + [f"ref_{q}" for q in ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s", "accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")]
        lines = [",".join(header)]
        for k, row in enumerate(np.concatenate([rate, force], 1)):
            lines.append(",".join([repr(k / RATE_HZ)] + [repr(float(value)) for value in row]))
        (folder / "motion.csv").write_text("\n".join(lines) + "\n")
        means, noise = motion_means(binary, folder, rate, force), motion_noise(binary, folder, rate, force)
    if means > WITHIN or noise > 5:
        sys.exit(f"along a motion: a mean deviates by {100 * means:.2f} %, a standard deviation by {noise:.1f} standard errors")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=pathlib.Path, default=ROOT / "target" / "release" / "vn100d")
    binary = parser.parse_args().binary
    if not binary.exists():
        sys.exit(f"{binary} is missing: run `cargo build --release` first, or name it with --binary")
    print("| noise | largest deviation |\n|---|---|")
    worst = 0
    for name in CHANNELS:
        ours, largest = found(binary, name), 0
        for quantity, mean, sd in expected(name):
            for key, values in (("mean", mean), ("sd", sd)):
                for own, peer in zip(ours[quantity][key], values):
                    largest = max(largest, abs(own - peer) / abs(peer) if peer else abs(own))
        print(f"| {name} | {largest:.0e} |")
        worst = max(worst, largest)
    motion_check(binary)
    sys.exit(0 if worst <= WITHIN else f"a deviation of {100 * worst:.2f} % exceeds {100 * WITHIN:.0f} %")


if __name__ == "__main__":
    main()
