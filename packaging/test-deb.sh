#!/usr/bin/env bash
# Installs the package given, has systemd, lintian and man judge it, lets the installed program work, removes and purges it,
# and asserts that the data stays to the byte. Changes this machine: for CI and containers, as root. Without a running
# systemd the maintainer scripts must cope.
set -euo pipefail

deb=${1:?usage: test-deb.sh FILE.deb}
say() { echo "-- $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }
[ "$(id -u)" = 0 ] || fail "needs root"
[ ! -e /var/lib/vn100d ] && [ ! -e /etc/vn100d ] && ! command -v vn100d >/dev/null \
  || fail "vn100d is installed here, or was: not on a machine in use"
emulator='' daemon=''
known=$(getent passwd vn100d || true)
work=$(mktemp -d)
cleanup() {
  for process in $daemon $emulator; do kill "$process" 2>/dev/null || true; done
  dpkg --purge vn100d >/dev/null 2>&1 || true
  # All of this was absent before this test.
  [ -n "$known" ] || userdel vn100d 2>/dev/null || true
  rm -rf /var/lib/vn100d /etc/vn100d "$work"
}
trap cleanup EXIT

# True where the tool is at hand; else says so, or fails where CI requires it.
have() {
  command -v "$1" >/dev/null && return
  [ -z "${VN100D_REQUIRE_TOOLS:-}" ] || fail "$1 is required here"
  echo "skipped: $1 is not at hand"
  [ -z "${VN100D_SKIPPED:-}" ] || echo "test-deb.sh: $1 is not at hand" >>"$VN100D_SKIPPED"
  return 1
}

say "lintian"
if have lintian; then
  lintian --fail-on error --suppress-tags bad-distribution-in-changes-file --tag-display-limit 0 "$deb"
fi

say "install"
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$(realpath "$deb")" >"$work/apt" 2>&1 || { cat "$work/apt"; fail "apt"; }
[ "$(dpkg-query -W -f '${Status}' vn100d)" = "install ok installed" ] || fail "not installed"
getent passwd vn100d >/dev/null || fail "no user vn100d"
id -nG vn100d | tr ' ' '\n' | grep -qx dialout || fail "vn100d is not in dialout"
[ "$(stat -c '%a %U:%G' /etc/vn100d/token)" = "640 root:vn100d" ] || fail "the token: $(stat -c '%a %U:%G' /etc/vn100d/token)"
grep -qxE '[0-9a-f]{48}' /etc/vn100d/token || fail "the token is none"
token=$(cat /etc/vn100d/token)
[ ! -e /etc/systemd/system/multi-user.target.wants/vn100d.service ] || fail "enabled without being asked"
vn100d --version
for exe in /proc/[0-9]*/exe; do
  [ "$(readlink "$exe" 2>/dev/null)" != /usr/bin/vn100d ] || fail "a daemon runs without being asked"
done

say "files"
for file in /usr/bin/vn100d /lib/systemd/system/vn100d.service /lib/systemd/system/vn100d@.service \
  /usr/lib/sysusers.d/vn100d.conf /lib/udev/rules.d/70-vn100.rules /usr/share/doc/vn100d/README.md \
  /usr/share/doc/vn100d/copyright /usr/share/bash-completion/completions/vn100d \
  /usr/share/zsh/vendor-completions/_vn100d /usr/share/fish/vendor_completions.d/vn100d.fish; do
  [ -s "$file" ] || [ -s "$file.gz" ] || fail "$file is missing"
done
dpkg-query -W -f '${Conffiles}' vn100d | grep -q ' /etc/vn100d/vn100d.toml ' || fail "no conffile"
bash -n /usr/share/bash-completion/completions/vn100d
if have udevadm; then
  # Releases before 254 have no `verify`; the rule is then judged by nobody, and that is said.
  if udevadm verify --help >/dev/null 2>&1; then
    udevadm verify /lib/udev/rules.d/70-vn100.rules
  else
    echo "skipped: $(udevadm --version | sed 's/^/udevadm /') cannot verify rules"
  fi
fi

say "manual"
pages=$(dpkg -L vn100d | grep '/man1/.*\.1\.gz$' || true)
[ "$(wc -l <<<"$pages")" -ge 10 ] || fail "only these man pages: $pages"
for page in $pages; do
  if have mandoc; then
    # Styles of a generated page are no errors.
    gunzip -c "$page" | mandoc -T lint -W error || fail "$page"
  fi
  if have man; then
    said=$(LC_ALL=C.UTF-8 MANWIDTH=100 man --warnings -E UTF-8 -l "$page" 2>&1 >"$work/page") || fail "$page"
    [ -z "$said" ] || fail "$page: $said"
    [ -s "$work/page" ] || fail "$page is empty"
  fi
done

say "units"
if have systemd-analyze; then
  for unit in vn100d.service vn100d@left.service; do
    # What it says about other units of this machine is not ours; its status is.
    systemd-analyze verify "$unit" >"$work/verify" 2>&1 || { cat "$work/verify"; fail "$unit"; }
    ! grep vn100d "$work/verify" || fail "$unit"
  done
  systemd-analyze security --offline=true --threshold=20 vn100d.service | tail -n 1
  systemd-analyze security --offline=true --threshold=20 vn100d@left.service | tail -n 1
fi

say "the installed program, as its user, with the installed configuration"
install -d -o vn100d -g vn100d -m 755 /var/lib/vn100d
vn100d emulate --link "$work/sensor" >/dev/null & emulator=$!
for _ in $(seq 100); do [ -e "$work/sensor" ] && break; sleep 0.1; done
chmod 755 "$work"
chown vn100d "$(realpath "$work/sensor")"
setpriv --reuid vn100d --regid vn100d --init-groups env -i PATH=/usr/bin:/bin STATE_DIRECTORY=/var/lib/vn100d \
  vn100d run --device "$work/sensor" --listen 127.0.0.1:8177 --capture 3s 2>"$work/log" & daemon=$!
for _ in $(seq 300); do
  state=$(vn100d --data-dir /var/lib/vn100d --json show latest 2>/dev/null | grep '"state"' || true)
  case $state in *complete*) break ;; esac
  sleep 0.1
done
case $state in *complete*) ;; *) cat "$work/log"; fail "the capture is not complete: $state" ;; esac
kill -TERM "$daemon"
wait "$daemon" || fail "the daemon ended with $?"
daemon=''
vn100d --data-dir /var/lib/vn100d check || fail "check finds something"
install -d -o vn100d -g vn100d /var/lib/vn100d/left
echo instance >/var/lib/vn100d/left/vn100d.db
kill "$emulator"
wait "$emulator" || true
emulator=''

say "a shared machine: the group's users change something, others do not"
sed -i 's|^#token-file = ""|token-file = "/etc/vn100d/token"|' /etc/vn100d/vn100d.toml
install -d -o vn100d -g vn100d -m 755 "$work/shared"
setpriv --reuid vn100d --regid vn100d --init-groups env -i PATH=/usr/bin:/bin STATE_DIRECTORY="$work/shared" \
  vn100d run --device /nowhere --listen 127.0.0.1:8177 2>"$work/log" & daemon=$!
printf 'time_s,gyro_x_rad_s\n0.000,0.1\n0.025,0.2\n0.050,0.1\n' >"$work/recording.csv"
# Somebody in no group of ours, and somebody in the group; each with the system's configuration and with one of its own.
asking() { who=$1; shift; case $who in
  stranger) setpriv --reuid nobody --regid nogroup --clear-groups env -i PATH=/usr/bin:/bin "$@" ;;
  member) setpriv --reuid nobody --regid nogroup --groups "$(getent group vn100d | cut -d: -f3)" env -i PATH=/usr/bin:/bin "$@" ;;
esac; }
for _ in $(seq 100); do asking stranger vn100d status --listen 127.0.0.1:8177 >"$work/status" 2>&1 && break; sleep 0.1; done
grep -q 'vn100d ' "$work/status" || { cat "$work/status" "$work/log"; fail "a stranger cannot read the status"; }
echo '[log]' >"$work/own.toml"
for own in '' "$work/own.toml"; do
  import=(vn100d ${own:+--config "$own"} --data-dir "$work/shared" import --listen 127.0.0.1:8177 "$work/recording.csv")
  ! asking stranger "${import[@]}" >"$work/import" 2>&1 || fail "a stranger changes something"
  grep -q 'group vn100d' "$work/import" || { cat "$work/import"; fail "a stranger is not told of the group"; }
  asking member "${import[@]}" >"$work/import" 2>&1 || { cat "$work/import"; fail "a member of the group is refused"; }
done
kill -TERM "$daemon"
wait "$daemon" || fail "the daemon ended with $?"
daemon=''
sums() { find /var/lib/vn100d -type f -print0 | sort -z | xargs -0 sha256sum; }
before=$(sums)

say "upgrade to the same version: a changed configuration stays"
echo '# changed here' >>/etc/vn100d/vn100d.toml
touch /etc/vn100d/left.toml
dpkg -i "$deb" >/dev/null
tail -n 1 /etc/vn100d/vn100d.toml | grep -q 'changed here' || fail "the upgrade took the configuration"
[ "$(cat /etc/vn100d/token)" = "$token" ] || fail "the upgrade made another token"
ln -sf /lib/systemd/system/vn100d.service /etc/systemd/system/multi-user.target.wants/vn100d.service

say "remove: configuration and data stay"
apt-get remove -y -qq vn100d >/dev/null
[ ! -e /usr/bin/vn100d ] || fail "still there"
tail -n 1 /etc/vn100d/vn100d.toml | grep -q 'changed here' || fail "remove took the configuration"
[ "$(sums)" = "$before" ] || fail "remove changed the data"

say "purge: data and configurations that are not the package's stay"
apt-get purge -y -qq vn100d >/dev/null
[ ! -e /etc/vn100d/vn100d.toml ] && [ ! -e /etc/vn100d/token ] || fail "purge left the configuration"
[ -e /etc/vn100d/left.toml ] || fail "purge took an instance's configuration"
[ ! -L /etc/systemd/system/multi-user.target.wants/vn100d.service ] || fail "purge left a dangling link"
[ "$(sums)" = "$before" ] || fail "purge changed the data"
getent passwd vn100d >/dev/null || fail "purge took the owner of the data"
echo "the package is good"
