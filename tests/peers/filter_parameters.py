#!/usr/bin/env python3
"""`vn100d noise --consistent` beside an implementation of its own: do both find the same filter parameters?

    cargo build --release && python3 tests/peers/filter_parameters.py [--binary target/release/vn100d]

Here the weights of the samples are listed one by one. A covariance is a sum over the innovations of each noise (white noise, a
walk, a first-order process) or over the phases of a tone, in the time domain; the divergence is computed with a Cholesky
decomposition and minimised by the simplex of Nelder and Mead. `vn100d` integrates spectra and diagonalises both kinds of noise
instead; nothing is shared but the definition of docs/filters.md. The check fails (exit code 1) if a real standard deviation or
a parameter differs by more than 1 %, or if the covering pair does not cover. Needs the standard library alone.
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
RATE_HZ, ALIGN = 40.0, 1200
WITHIN = 0.01
N, K = 1.2e-4, 1.5e-6
MODELS = {
    "N, K": {},
    "N, K, tone": {"tone": (13.38, 1e-2)},
    "N, K, slow tone": {"tone": (0.31, 1e-3)},
    "N, K, Gauss-Markov": {"markov": (3e-5, 20.0)},
    "N, K, tone, Gauss-Markov": {"tone": (13.38, 1e-2), "markov": (3e-4, 20.0)},
}


def document(binary, parts):
    effects = []
    if "tone" in parts:
        effects.append({"effect": "tone", "frequency_hz": parts["tone"][0], "amplitude": parts["tone"][1]})
    if "markov" in parts:
        effects.append({"effect": "gauss_markov", "sigma": parts["markov"][0], "tc_s": parts["markov"][1]})
    model = {"format": "vn100d-sensor-model-1", "name": "peer", "rate_hz": RATE_HZ,
             "channels": {"gyro_z": {"N": N, "K": K, "effects": effects}}}
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "model.json"
        path.write_text(json.dumps(model))
        command = [binary, "noise", "--model", path, "--consistent", "--json"]
        return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


def weights(horizon, longest):
    return [-horizon / ALIGN] * ALIGN + [1.0] * horizon + [0.0] * (longest - horizon)


def innovations(of, pole):
    """What an innovation at each sample does to the weighted sum of a first-order process."""
    found, later = [0.0] * len(of), 0.0
    for place in range(len(of) - 1, -1, -1):
        later = of[place] + pole * later
        found[place] = later
    return found


def dot(one, other):
    return sum(a * b for a, b in zip(one, other))


def covariance(rows, first=1.0):
    """Of sums of innovations of variance 1; the first has the variance `first`."""
    return [[(dot(one, other) + (first - 1.0) * one[0] * other[0]) / RATE_HZ**2 for other in rows] for one in rows]


def moments(horizons, parts):
    rows = [weights(horizon, horizons[-1]) for horizon in horizons]
    white = [[RATE_HZ * value for value in row] for row in covariance(rows)]
    walk = [[value / RATE_HZ for value in row] for row in covariance([innovations(row, 1.0) for row in rows])]
    real = [[N * N * a + K * K * b for a, b in zip(one, two)] for one, two in zip(white, walk)]
    more = []
    if "tone" in parts:
        hz, amplitude = parts["tone"]
        waves = [[wave(2 * math.pi * hz * k / RATE_HZ) for k in range(len(rows[0]))] for wave in (math.cos, math.sin)]
        sums = [[amplitude * dot(row, wave) / RATE_HZ for wave in waves] for row in rows]
        more.append([[0.5 * dot(one, other) for other in sums] for one in sums])
    if "markov" in parts:
        sigma, tc_s = parts["markov"]
        pole = math.exp(-1.0 / (RATE_HZ * tc_s))
        own = covariance([innovations(row, pole) for row in rows], 1.0 / (1.0 - pole * pole))
        more.append([[sigma * sigma * (1.0 - pole * pole) * value for value in row] for row in own])
    for extra in more:
        real = [[a + b for a, b in zip(one, two)] for one, two in zip(real, extra)]
    return white, walk, real


def cholesky(matrix):
    size = len(matrix)
    lower = [[0.0] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[i][j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            if i == j and rest <= 0.0:
                return None
            lower[i][j] = math.sqrt(rest) if i == j else rest / lower[j][j]
    return lower


def distance(white, walk, real, n, k):
    """Twice the divergence up to a constant: tr(P^-1 C) + ln det P."""
    size = len(real)
    lower = cholesky([[n * n * a + k * k * b for a, b in zip(one, two)] for one, two in zip(white, walk)])
    if lower is None:
        return math.inf
    trace = 0.0
    # P^-1 C = L^-T L^-1 C: its trace from both solutions.
    half = [[0.0] * size for _ in range(size)]
    for column in range(size):
        for i in range(size):
            half[i][column] = (real[i][column] - sum(lower[i][k] * half[k][column] for k in range(i))) / lower[i][i]
    for row in range(size):
        own = [0.0] * size
        for i in range(size):
            own[i] = (half[row][i] - sum(lower[i][k] * own[k] for k in range(i))) / lower[i][i]
        trace += own[row]
    return trace + 2.0 * sum(math.log(lower[i][i]) for i in range(size))


def simplex(function, start, step=0.5, rounds=300):
    points = [start, [start[0] + step, start[1]], [start[0], start[1] + step]]
    values = [function(*point) for point in points]
    for _ in range(rounds):
        order = sorted(range(3), key=lambda k: values[k])
        points, values = [points[k] for k in order], [values[k] for k in order]
        middle = [(points[0][k] + points[1][k]) / 2 for k in range(2)]

        def at(share):
            return [middle[k] + share * (points[2][k] - middle[k]) for k in range(2)]

        for share in (-2.0, -1.0, -0.5, 0.5):
            point = at(share)
            value = function(*point)
            if value < values[2]:
                points[2], values[2] = point, value
                break
        else:
            points = [points[0]] + [[(points[0][k] + point[k]) / 2 for k in range(2)] for point in points[1:]]
            values = [values[0]] + [function(*point) for point in points[1:]]
    return points[0]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target/release/vn100d", type=pathlib.Path)
    binary = parser.parse_args().binary.resolve()
    failed = False
    print("| model | real sd | N of the closest pair | K of the closest pair | farther than the simplex, 2 nats | covering pair: real over predicted |")
    print("|---|---|---|---|---|---|")
    for name, parts in MODELS.items():
        found = document(binary, parts)
        of = found["channels"]["gyro_z"]
        horizons = [round(RATE_HZ * horizon) for horizon in found["horizons_s"]]
        white, walk, real = moments(horizons, parts)
        fit, cover = of["white_and_walk"]["fit"], of["white_and_walk"]["cover"]
        sd = max(abs(own / math.sqrt(real[k][k]) - 1) for k, own in enumerate(of["real_sd"]))
        log_n, log_k = simplex(lambda n, k: distance(white, walk, real, math.exp(n), math.exp(k)),
                               [math.log(2 * N), math.log(2 * K)])
        off_n = abs(fit["N"] / math.exp(log_n) - 1)
        # The simplex walks towards a walk of 0 for ever: then the pair without one is at least as close.
        farther = (distance(white, walk, real, fit["N"], fit["K"])
                   - distance(white, walk, real, math.exp(log_n), math.exp(log_k)))
        off_k = 0.0 if fit["K"] == 0 and farther < 1e-9 else abs(fit["K"] / math.exp(log_k) - 1)
        ratio = max(math.sqrt(real[k][k] / (cover["N"] ** 2 * white[k][k] + cover["K"] ** 2 * walk[k][k]))
                    for k in range(len(horizons)))
        print(f"| {name} | {sd:.0e} | {off_n:.0e} | {off_k:.0e} | {farther:.0e} | {ratio:.4f} |")
        failed |= max(sd, off_n, off_k) > WITHIN or farther > 1e-6 or ratio > 1.0001
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
