"""Prints the table of docs/architecture.md: files, lines of code and longest file of each crate, without tests and comments.

    python3 tests/scale/sizes.py
"""

import json
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]


def is_code(path):
    return "tests" not in path.parts and path.stem != "tests" and not path.stem.endswith("_test")


def lines(path):
    text = path.read_text().split("#[cfg(test)]\nmod tests {")[0]
    return sum(1 for line in text.splitlines() if line.strip() and not line.strip().startswith("//"))


metadata = json.loads(subprocess.check_output(
    ["cargo", "metadata", "--offline", "--no-deps", "--format-version", "1"], cwd=ROOT))
print("| package | files | lines of code | longest file | direct dependencies |\n|---|---|---|---|---|")
for package in sorted(metadata["packages"], key=lambda package: package["name"]):
    folder = pathlib.Path(package["manifest_path"]).parent / "src"
    sizes = [(lines(path), path.relative_to(folder)) for path in folder.rglob("*.rs") if is_code(path.relative_to(folder))]
    needed = sum(1 for dependency in package["dependencies"] if dependency["kind"] is None)
    longest, name = max(sizes)
    print(f"| `{package['name']}` | {len(sizes)} | {sum(size for size, _ in sizes):,} | `{name}`, {longest} | {needed} |")
