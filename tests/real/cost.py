#!/usr/bin/env python3
"""Held-out error growth: the model of a recording's first half against the pieces of its second half.

    python3 tests/real/cost.py PROGRAM FOLDER [NAME…]

PROGRAM is the built vn100d, FOLDER the folder of real recordings (docs/validation.md). For each recording at rest the first
half gives a model (`model fit --effects all`), and `cost --real` measures the second half, which begins that much later. Horizons go up
to a tenth of the record. Prints a row for each recording and triad: by horizon the share of pieces inside the model's 95 % band,
a mean over the quantities of the triad, and the least number of independent pieces.
"""

import gzip
import json
import pathlib
import subprocess
import sys
import tempfile

# Recordings at rest, their length in seconds, and the rate of those without stamps.
STILL = [
    ("vn100-desk/live_capture.txt.gz", 754, 40),
    ("adis16405/adis_16405_imu1.csv.gz", 10000, 100),
    ("adis16405/adis_16405_imu2.csv.gz", 10000, 100),
    ("adis16405/adis_16405_imu3_first200k.csv.gz", 2000, 100),
    ("mpu6050/still-10min.csv.gz", 655, None),
    *[(f"memsense/turn_on_0{number}.csv.gz", 52, None) for number in range(1, 7)],
    *[(f"xsens_dot/x_stat_{number}.csv.gz", 120, None) for number in range(1, 5)],
    ("repoimu/TStick_Test01_Static.csv.gz", 181, None),
]
HORIZONS = [0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600, 1000]
TRIADS = {
    "gyro": ["attitude_x", "attitude_y", "heading"],
    "accel": ["velocity_x", "velocity_y", "position_x", "position_y"],
}


def halves(file, folder):
    """Writes both halves of a recording and returns their paths."""
    lines = gzip.open(file, "rt").read().splitlines(keepends=True)
    head = [] if lines[0].startswith("$") else [lines.pop(0)]
    middle = len(lines) // 2
    suffix = "txt" if not head else "csv"
    paths = []
    for name, rows in (("first", lines[:middle]), ("second", lines[middle:])):
        path = folder / f"{name}.{suffix}"
        path.write_text("".join(head + rows))
        paths.append(str(path))
    return paths


def measure(program, folder, name, length_s, rate_hz):
    """Returns the measured document of the second half, or the refusal."""
    with tempfile.TemporaryDirectory() as place:
        place = pathlib.Path(place)
        first, second = halves(folder / name, place)
        rate = ["--rate", str(rate_hz)] if rate_hz else []
        model = str(place / "model.json")
        fit = [program, "model", "fit", first, "--effects", "all", "--force", "--out", model, *rate]
        fitted = subprocess.run(fit, capture_output=True, text=True)
        if fitted.returncode not in (0, 3):
            return None, fitted.stderr.strip().splitlines()[-1]
        found = json.loads(pathlib.Path(model).read_text())
        effects = sorted({f"{one['effect']}" for of in found["channels"].values() for one in of.get("effects", [])})
        align_s = min(30.0, length_s / 40)
        horizons = [of for of in HORIZONS if of <= length_s / 10 and 5 * (of + align_s) < 0.49 * length_s]
        command = [program, "--json", "cost", "--model", model, "--real", second, "--after", f"{length_s / 2}s"]
        command += ["--align", f"{align_s}s", "--horizons", ",".join(f"{of}s" for of in horizons), *rate]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode not in (0, 3):
            return None, run.stderr.strip().splitlines()[-1]
        return json.loads(run.stdout)["measured"], ", ".join(effects) or "none"


def main():
    """Prints the table."""
    program, folder, names = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3:]
    inside = outside = 0
    for name, length_s, rate_hz in STILL:
        if names and not any(of in name for of in names):
            continue
        measured, words = measure(program, folder, name, length_s, rate_hz)
        if measured is None:
            print(f"| {name} | – | {words} |", flush=True)
            continue
        for triad, quantities in TRIADS.items():
            cells = []
            for place, horizon in enumerate(measured["horizons_s"]):
                pieces = [measured["quantities"][of]["pieces"][place] for of in quantities if of in measured["quantities"]]
                pieces = [of for of in pieces if of]
                if pieces:
                    share = sum(of["coverage"] for of in pieces) / len(pieces)
                    least = min(of["independent"] for of in pieces)
                    ratio = (sum((of["rms"] / of["predicted_rms"]) ** 2 for of in pieces) / len(pieces)) ** 0.5
                    fits = all(of["coverage_ci95"][0] <= 0.98 and of["coverage_ci95"][1] >= 0.90 for of in pieces)
                    inside, outside = inside + fits, outside + (not fits)
                    cells.append(f"{horizon:g} s: {100 * share:.0f} % ({least:.0f}; rms × {ratio:.2f}){'' if fits else ' !'}")
            if cells:
                print(f"| {name} | {triad} | {'; '.join(cells)} | {words} |", flush=True)
    print(f"\n{inside} horizons of a triad agree with 90–98 %, {outside} do not (!)")


if __name__ == "__main__":
    main()
