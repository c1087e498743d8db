#!/usr/bin/env bash
# Builds the Debian package; prints its path last. `--profile dev` packages the program that `cargo test` has built: good
# for trying the package out, slow as a program. Needs cargo-deb (cargo install cargo-deb --locked).
set -euo pipefail
cd "$(dirname "$0")/.."

profile=dist
if [ "${1:-}" = --profile ]; then profile=$2; fi
case $profile in
  dev) folder=debug ;;
  *) folder=$profile ;;
esac

if [ "$profile" = dev ]; then
  # With the features that the tests ask of the dependencies, as cargo test has built it: nothing is built twice.
  cargo test --no-run --locked --test systemd >&2
else
  cargo build --locked --profile "$profile" --bin vn100d >&2
fi
# Made of the program's own arguments, so that they cannot differ from them.
rm -rf target/package target/debian
"target/$folder/vn100d" generate man target/package/man
"target/$folder/vn100d" generate completions target/package/completions
cargo deb --no-build --profile "$profile" --output target/debian/ >&2
ls -t "$PWD"/target/debian/vn100d_*.deb | head -n 1
