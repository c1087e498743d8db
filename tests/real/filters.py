#!/usr/bin/env python3
"""A filter with datasheet's, Allan and consistent values on the second halves of recordings at rest.

    cargo build --release && cargo build --release -p imu-judge --example filter_judge
    python3 tests/real/filters.py PROGRAM JUDGE FOLDER [NAME…]

PROGRAM is the built vn100d, JUDGE the built example, FOLDER the folder of real recordings (docs/validation.md). For each recording
at rest the first half gives a model without effects, whose N and K are those of the Allan rows, and one with them
(`--effects all`), from which the consistent pairs follow. The judge filters the second half. Prints the tables of docs/filters.md,
then in how many recordings each filter is within its bounds and scores best.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

from cost import STILL, halves

FILTERS = ["datasheet", "Allan × 1", "Allan × 10", "closest", "covering"]


def run(*command):
    """Runs a program and returns what it prints, or None with the last line of its refusal."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode in (0, 3):
        return done.stdout, None
    return None, (done.stderr.strip() or "no reason given").splitlines()[-1]


def judge(program, judge_program, folder, name, rate_hz):
    """Returns both rows of cells and the line on the outages, and the effects; or None and the refusal."""
    with tempfile.TemporaryDirectory() as place:
        place = pathlib.Path(place)
        first, second = halves(folder / name, place)
        rate = ["--rate", str(rate_hz)] if rate_hz else []
        plain, model, samples = (str(place / of) for of in ("plain.json", "model.json", "samples.csv"))
        for command in (
            ["model", "fit", first, "--force", "--out", plain, *rate],
            ["model", "fit", first, "--effects", "all", "--force", "--out", model, *rate],
            ["export", second, "--out", samples, *rate],
        ):
            printed, refusal = run(program, *command)
            if printed is None:
                return None, refusal
        printed, refusal = run(judge_program, "held-out", plain, model, samples)
        if printed is None:
            return None, refusal
        channels = json.loads(pathlib.Path(model).read_text())["channels"].values()
        effects = sorted({one["effect"] for of in channels for one in of.get("effects", [])})
        return printed.splitlines(), ", ".join(effects) or "none"


def main():
    """Prints the tables."""
    program, judge_program, folder, names = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3]), sys.argv[4:]
    scores, inside, best, judged = [], [0] * len(FILTERS), [0] * len(FILTERS), 0
    head = f"{' | '.join(FILTERS)} |\n|---|---|{'---|' * len(FILTERS)}"
    print(f"| recording | outages | {head}")
    for name, _, rate_hz in STILL:
        if names and not any(of in name for of in names):
            continue
        lines, words = judge(program, judge_program, folder, name, rate_hz)
        if lines is None:
            print(f"| {name} | – {words} |", flush=True)
            continue
        nees, coverage, outages = lines
        print(f"| {name} | {outages} | {nees} |", flush=True)
        scores.append(f"| {name} | {words} | {coverage} |")
        judged += 1
        for place, (one, other) in enumerate(zip(nees.split(" | "), coverage.split(" | "))):
            inside[place] += not one.split()[0].endswith("!")
            best[place] += not other.endswith("!")
    print(f"\n| recording | effects | {head}")
    print("\n".join(scores), end="\n\n")
    for place, name in enumerate(FILTERS):
        print(f"{name}: in its bounds in {inside[place]} of {judged} recordings, log score best or within 2 % in {best[place]}")


if __name__ == "__main__":
    main()
