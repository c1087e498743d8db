#!/usr/bin/env python3
"""`vn100d cost` beside an implementation of its own in numpy: do both grow errors alike?

    cargo build --release && python3 tests/peers/cost.py [--binary target/release/vn100d]

Here the weights of the samples are listed one by one, and a variance is a double sum over them and the noise's
covariance or structure function in the time domain. `vn100d` integrates spectra in closed form instead; nothing is
shared but the definition of docs/cost.md. N, B, K, a tone, a ramp and a Gauss-Markov process, each on the gyroscope and the
accelerometer, at twelve horizons from 1 s to an hour: the check fails (exit code 1) if a number differs by more than 1 %.
Needs numpy alone.
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
    sys.exit(0 if worst <= WITHIN else f"a deviation of {100 * worst:.2f} % exceeds {100 * WITHIN:.0f} %")


if __name__ == "__main__":
    main()
