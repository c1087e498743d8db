# Shared by .ci/run and .ci/full: tools, real recordings, steps with their times.
export CARGO_TERM_COLOR=${CARGO_TERM_COLOR:-never}
# Nothing is built twice here, and code that is compiled in larger units is faster.
export CARGO_INCREMENTAL=0
times=()
# Each test that does without a tool or a recording leaves a line there.
mkdir -p target
VN100D_SKIPPED=$PWD/target/skipped
export VN100D_SKIPPED
: >"$VN100D_SKIPPED"

# Package by package what the tests call; root on Debian installs what is missing.
tools="strace:strace udevadm:udev setpriv:util-linux sqlite3:sqlite3 systemd-analyze:systemd systemd-sysusers:systemd lintian:lintian
  dpkg-shlibdeps:dpkg-dev mandoc:mandoc man:man-db xz:xz-utils node:nodejs npm:npm chromium:chromium"

install_tools() {
  local missing=() entry
  for entry in $tools; do
    command -v "${entry%%:*}" >/dev/null || missing+=("${entry##*:}")
  done
  ls /usr/lib/*/faketime/libfaketime.so.1 >/dev/null 2>&1 || missing+=(libfaketime)
  python3 -c 'import ensurepip, venv' >/dev/null 2>&1 || missing+=(python3-venv)
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    if [ "${#missing[@]}" -gt 0 ]; then
      apt-get update -qq
      DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
    fi
    # Python's readers of what is exported, in a virtual environment under target.
    step python3 tests/peers/exports.py --install
    # The browser's driver and the rules of accessibility, under target as well.
    step node tests/browser/pages.mjs --install
    # From here on a test that cannot find its tool fails.
    export VN100D_REQUIRE_TOOLS=1
  elif [ "${#missing[@]}" -gt 0 ]; then
    echo "not at hand, and not installed without root: ${missing[*]}; the tests say what they skip"
  fi
}

find_real_data() {
  if [ -z "${VN100D_REAL_DATA:-}" ] && [ -d ../shared/data ]; then
    VN100D_REAL_DATA=$(cd ../shared/data && pwd)
  fi
  if [ -n "${VN100D_REAL_DATA:-}" ]; then
    export VN100D_REAL_DATA VN100D_REQUIRE_DATA=1
    echo "real recordings: $VN100D_REAL_DATA"
  else
    echo "real recordings: none here, so the tests on them are skipped (set VN100D_REAL_DATA)"
  fi
}

# The package is installed and purged: only as root, and not where vn100d is in use.
can_package() {
  if [ "$(id -u)" != 0 ] || ! command -v dpkg >/dev/null || [ -e /var/lib/vn100d ] || [ -e /etc/vn100d ]; then
    echo "the package is not tried out: that needs root on a Debian machine where vn100d is not installed"
    return 1
  fi
  # Without its own lzma: xz is there.
  cargo deb --version >/dev/null 2>&1 || step cargo install cargo-deb --version 3.8.0 --locked --no-default-features || exit 1
}

# `cargo test` with a filter: a filter that nothing matches is no success.
filtered() {
  local said=target/filtered
  "$@" 2>&1 | tee "$said"
  grep -qE '^test result: ok\. [1-9][0-9]* passed' "$said" || { echo "no test has passed: $*"; return 1; }
}

step() {
  echo
  echo "== $*"
  local begun=$SECONDS outcome=0
  "$@" || outcome=$?
  times+=("$(printf '%5d s  %s%s' $((SECONDS - begun)) "$*" "$([ "$outcome" = 0 ] || echo "  (exit $outcome)")")")
  return "$outcome"
}

summary() {
  echo
  echo "== times"
  printf '%s\n' "${times[@]}"
  echo "== skipped: $(wc -l <"$VN100D_SKIPPED")"
  sort "$VN100D_SKIPPED" | uniq -c
  echo "$(printf '%5d s  in all' "$SECONDS")"
}
