#!/usr/bin/env python3
"""Runs the blind check on every still recording of the folder of real recordings, and adds up what it counts.

    cargo build --release
    VN100D_REAL_DATA=... python3 tests/real/backgrounds.py tuned [--cases 40] [--seed 1]
    VN100D_REAL_DATA=... python3 tests/real/backgrounds.py kept

`tuned` takes the first halves of the recordings, which may be looked at while the diagnosis is built. `kept` takes the second
halves, and whole recordings of which nobody looks at any part before; of the ADIS16405, whose diagnosis takes half a minute,
40,000 samples are taken out of each half. Recordings of less than 20,000 samples have no half of
10,000, the length of the shortest case: of a series of them the first ones are tuned on and the others are kept.

Each part is cut into a table of its own, `vn100d trial --on` runs on it (docs/trial.md, "On a recording"), and the counts of all
parts are added. Intervals are Clopper and Pearson's, 95 %; they take cases as independent, which cases of one stretch are not, so
they are too narrow. The standard library is all that is needed.
"""

import argparse
import gzip
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
ADIS = "adis16405/adis_16405_imu{}.csv.gz"


def series(name, file, length, tuned):
    """Recordings 1, 2, ... of one kind and `length`, each used whole: of those whose place is below `tuned` for tuning."""
    return [(f"{name} {k + 1}", file.format(k + 1), None, *(((0, length), None) if k < tuned[0] else (None, (0, length))))
            for k in range(tuned[1])]


# Name, file, rate of files without stamps, first and last row of the part that is tuned on, and of the kept part.
PARTS = [
    ("VN-100 desk", "vn100-desk/live_capture.txt.gz", 40, (0, 15_089), (15_089, 30_178)),
    ("ADIS16405 1", ADIS.format(1), 100, (0, 40_000), (500_000, 540_000)),
    ("ADIS16405 2", ADIS.format(2), 100, None, (0, 40_000)),
    ("ADIS16405 3", ADIS.format("3_first200k"), 100, (0, 40_000), (100_000, 140_000)),
    ("MPU-6050", "mpu6050/still-10min.csv.gz", None, (0, 32_533), (32_533, 65_067)),
    *series("Memsense", "memsense/turn_on_0{}.csv.gz", 13_000, (3, 6)),
    *series("Xsens DOT", "xsens_dot/x_stat_{}.csv.gz", 14_459, (2, 4)),
    ("Xsens MTi stick", "repoimu/TStick_Test01_Static.csv.gz", None, (0, 18_154), None),
]
RATES = [
    "first_new", "new_spurious", "cause_and_sense_first", "all_found", "library_unknown", "control_named", "control_unknown",
    "halves_clean", "halves_named", "halves_unknown", "placed", "false_place", "sure_right", "intervals_hold", "refused",
]


def main():
    """Runs the parts and prints a table in Markdown."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("which", choices=["tuned", "kept"])
    arguments.add_argument("--cases", type=int, default=40, help="cases of each part")
    arguments.add_argument("--seed", type=int, default=1, help="seed of the first part; each next one has the next seed")
    arguments.add_argument("--samples", type=int, default=20_000, help="samples of a case, where the part has as many")
    arguments.add_argument("--kinds", default="single", help="as of `vn100d trial`")
    arguments.add_argument("--only", default="", help="only parts whose name has this in it")
    arguments.add_argument("--out", type=pathlib.Path, help="a folder that keeps what each trial wrote")
    arguments.add_argument("--binary", type=pathlib.Path, default=ROOT / "target" / "release" / "vn100d")
    given = arguments.parse_args()
    data = os.environ.get("VN100D_REAL_DATA") or sys.exit("VN100D_REAL_DATA is not set: it has to name the folder of real recordings")
    parts = [(name, file, rate, tuned if given.which == "tuned" else kept) for name, file, rate, tuned, kept in PARTS]
    parts = [(number, part) for number, part in enumerate(parts) if part[3] and given.only in part[0]]
    total = {}
    print("| recording | cases | first new | spurious beside | halves not unknown |\n|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, file, rate, (first, last)) in parts:
            table = cut(pathlib.Path(data) / file, first, last, pathlib.Path(folder))
            out = (given.out or pathlib.Path(folder)) / f"{given.which}-{number:02}"
            command = [given.binary, "trial", "--on", table, "--cases", given.cases, "--seed", given.seed + number,
                       "--kinds", given.kinds, "--samples", given.samples, "--out", out, "--json"] + (["--rate", rate] if rate else [])
            done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
            table.unlink()
            if done.returncode:
                print(f"| {name} | – | {(done.stderr.strip().splitlines() or ['no answer'])[-1]} | | |", flush=True)
                continue
            rates = json.loads(done.stdout)["rates"]
            for rate_name in RATES:
                of = rates.get(rate_name) or {"count": 0, "of": 0}
                count, all_of = total.get(rate_name, (0, 0))
                total[rate_name] = (count + of["count"], all_of + of["of"])
            unknown = rates["halves_unknown"]
            print(f"| {name} | {given.cases} | {said(rates['first_new'])} | {said(rates['new_spurious'])} | "
                  f"{unknown['of'] - unknown['count']} of {unknown['of']} |", flush=True)
    print("\n| rate | all parts |\n|---|---|")
    for name, (count, of) in total.items():
        if of:
            low, high = interval(count, of)
            print(f"| `{name}` | {count} of {of}: {100 * count / of:.1f} % ({100 * low:.1f} to {100 * high:.1f} %) |")


def cut(path, first, last, folder):
    """Rows `first` to `last` (0-based, exclusive) of a table or of lines of a VN-100, as a file in `folder`."""
    with gzip.open(path, "rt") as lines:
        start = next(lines)
        head = [] if start.startswith("$") else [start]
        rows = [] if head else [start]
        for line in lines:
            if len(rows) >= last:
                break
            rows.append(line)
    out = folder / (path.name.removesuffix(".gz"))
    out.write_text("".join(head + rows[first:last]))
    return out


def said(rate):
    """A rate as `count of all`."""
    return f"{rate['count']} of {rate['of']}" if rate else "–"


def interval(count, of):
    """Clopper and Pearson's 95 % interval of a share, by bisection on the binomial distribution's tails."""
    def below(share, most):
        if share <= 0:
            return 1.0
        if share >= 1:
            return 1.0 if most >= of else 0.0
        logs = (math.lgamma(of + 1) - math.lgamma(k + 1) - math.lgamma(of - k + 1) + k * math.log(share)
                + (of - k) * math.log1p(-share) for k in range(most + 1))
        return sum(math.exp(value) for value in logs)

    def where(most, tail):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if below(middle, most) > tail else (low, middle)
        return (low + high) / 2

    return (where(count - 1, 0.975) if count else 0.0), (where(count, 0.025) if count < of else 1.0)


if __name__ == "__main__":
    main()
