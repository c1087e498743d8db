"""Prints the table of docs/architecture.md: files, lines of code and longest file of each crate, without tests and comments.

    python3 tests/scale/sizes.py
"""

import json
import pathlib
import re
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]


def of_tests(folder):
    """Files and folders that their parent declares behind #[cfg(test)]."""
    for path in folder.rglob("*.rs"):
        inside = path.parent if path.stem in ("mod", "lib", "main") else path.with_suffix("")
        for name in re.findall(r"#\[cfg\(test\)\]\n(?:pub )?mod (\w+);", path.read_text()):
            yield inside / f"{name}.rs"
            yield inside / name


def lines(path):
    text = path.read_text().split("#[cfg(test)]\nmod tests {")[0]
    return sum(1 for line in text.splitlines() if line.strip() and not line.strip().startswith("//"))


metadata = json.loads(subprocess.check_output(
    ["cargo", "metadata", "--offline", "--no-deps", "--format-version", "1"], cwd=ROOT))
print("| package | files | lines of code | longest file | direct dependencies |\n|---|---|---|---|---|")
for package in sorted(metadata["packages"], key=lambda package: package["name"]):
    folder = pathlib.Path(package["manifest_path"]).parent / "src"
    tests = set(of_tests(folder))
    code = [path for path in folder.rglob("*.rs") if not tests.intersection([path, *path.parents])]
    sizes = [(lines(path), path.relative_to(folder)) for path in code]
    needed = sum(1 for dependency in package["dependencies"] if dependency["kind"] is None)
    longest, name = max(sizes)
    print(f"| `{package['name']}` | {len(sizes)} | {sum(size for size, _ in sizes):,} | `{name}`, {longest} | {needed} |")
