#!/usr/bin/env bash
# Tries the container out: the last stage of the Dockerfile with the program given, which must record from an emulated
# sensor, answer its health check, refuse a change without the token, and keep its data over a restart. Where a container
# runtime answers, it builds the image and runs it. Elsewhere, as root, this script does the Dockerfile's steps in an empty
# root that has the program with its libraries and nothing else, with the limits of compose.yaml: another user, no
# capabilities, a root that is read-only, namespaces of its own.
set -euo pipefail
cd "$(dirname "$0")/.."

program=$(realpath "${1:?usage: test-container.sh PROGRAM}")
dockerfile=packaging/container/Dockerfile
compose=packaging/container/compose.yaml
say() { echo "-- $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }

if [ -z "${INSIDE:-}" ]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  install -D "$program" "$work/image/image/vn100d"
  install -D -m 644 /etc/ssl/certs/ca-certificates.crt "$work/image/image/ca-certificates.crt" 2>/dev/null \
    || install -D -m 644 /dev/null "$work/image/image/ca-certificates.crt"
  if docker info >/dev/null 2>&1; then
    say "a container runtime answers: the image, and compose.yaml"
    echo 0123456789abcdef0123456789abcdef >"$work/token"
    docker build -q -f "$dockerfile" --build-context build="$work/image" -t vn100d-test . >/dev/null
    if docker compose version >/dev/null 2>&1; then docker compose -f "$compose" config -q || fail "$compose"; fi
    container=$(docker run -d --read-only --tmpfs /tmp --cap-drop ALL --security-opt no-new-privileges:true \
      -v "$work/token:/run/secrets/token:ro" vn100d-test)
    trap 'docker rm -f -v "$container" >/dev/null 2>&1; rm -rf "$work"' EXIT
    for _ in $(seq 100); do docker exec "$container" vn100d status >/dev/null 2>&1 && break; sleep 0.2; done
    docker exec "$container" vn100d status || { docker logs "$container"; fail "the health check"; }
    [ "$(docker exec "$container" id -u)" = 990 ] || fail "not the user 990"
    docker stop -t 30 "$container" >/dev/null
    [ "$(docker inspect -f '{{.State.ExitCode}}' "$container")" = 0 ] || fail "the daemon ended with an error"
    echo "the image is good"
    exit 0
  fi
  [ "$(id -u)" = 0 ] || { echo "skipped: neither a container runtime nor root"; exit 0; }
  say "no container runtime answers: the Dockerfile's steps in an empty root"
  # Mounts, processes, the port and what is left running are this test's alone.
  INSIDE=1 WORK=$work unshare --mount --net --pid --fork --kill-child --mount-proc "$0" "$program"
  exit
fi

root=$WORK/root
ip link set lo up
mkdir -p "$root"/{bin,dev,etc,proc,run/secrets,tmp,usr/bin,usr/sbin,var/lib}
chmod 1777 "$root/tmp"
printf 'root:x:0:0:root:/root:/bin/sh\n' >"$root/etc/passwd"
printf 'root:x:0:\ndialout:x:20:\n' >"$root/etc/group"
# A program with its libraries, at the paths at which it looks for them.
libraries() { ldd "$1" | grep -o '/[^ ]*' | while read -r file; do [ -e "$root$file" ] || cp -L --parents "$file" "$root"; done; }
bring() {
  local file
  for name in "$@"; do
    file=$(command -v "$name")
    cp -L "$file" "$root/usr/bin/$name"
    libraries "$file"
  done
}
# What the base image has and the steps need.
bring sh useradd install
ln -s /usr/bin/sh "$root/bin/sh"
install -m 755 /dev/null "$root/usr/sbin/nologin"

say "the steps of the last stage"
declare -A environment=()
entrypoint='' command='' health='' user='' volume=''
words() { tr -d '[]",' <<<"$1"; }
while read -r instruction rest; do
  case $instruction in
    RUN) chroot "$root" /usr/bin/sh -c "$rest" || fail "RUN $rest" ;;
    COPY)
      case $rest in
        --from=build\ *) set -- ${rest#--from=build }; from=$WORK/image$1 ;;
        *) set -- $rest; from=$1 ;;
      esac
      [ $# = 2 ] || fail "COPY $rest: this script knows two paths"
      mkdir -p "$(dirname "$root$2")"
      cp "$from" "$root$2"
      ;;
    ENV) environment[${rest%%=*}]=${rest#*=} ;;
    USER) user=$rest ;;
    VOLUME) volume=$rest ;;
    HEALTHCHECK) health=$(words "${rest#*CMD }") ;;
    ENTRYPOINT) entrypoint=$(words "$rest") ;;
    CMD) command=$(words "$rest") ;;
    EXPOSE) ;;
    *) fail "$instruction: teach this script the instruction" ;;
  esac
done < <(sed -n '/^FROM debian/,$p' "$dockerfile" | sed '1d; /^ *#/d; /^ *$/d' | sed -e ':a; /\\$/N; s/\\\n//; ta')
libraries "$root${entrypoint%% *}"
id=$(grep "^$user:" "$root/etc/passwd" | cut -d: -f3)
[ "$id" = 990 ] || fail "the user $user is $id"
[ -n "$health" ] && [ -n "$command" ] && [ "$volume" = "${environment[VN100D_DATA_DIR]}" ] || fail "health check, command or volume"
rm "$root/usr/bin/"{sh,useradd,install} "$root/bin/sh"

say "the sensor, the token and the limits of compose.yaml"
for line in 'read_only: true' '- ALL' '- no-new-privileges:true' 'rtprio: 1' '- data:/var/lib/vn100d' 'file: ./token'; do
  grep -qF -- "$line" "$compose" || fail "$compose has no \`$line\`"
done
group=$(sed -n 's/.*VN100_GROUP:-\([0-9]*\)}.*/\1/p' "$compose")
device=$(sed -n 's|.*VN100_DEVICE:-[^}]*}:\([^"]*\)".*|\1|p' "$compose")
echo 0123456789abcdef0123456789abcdef >"$root/run/secrets/token"
chown "root:$id" "$root/run/secrets/token"
chmod 640 "$root/run/secrets/token"
"$program" emulate --link "$WORK/sensor" >/dev/null & emulator=$!
for _ in $(seq 100); do [ -e "$WORK/sensor" ] && break; sleep 0.1; done
port=$(realpath "$WORK/sensor")
chgrp "$group" "$port"
chmod 660 "$port"
touch "$root/dev/"{null,zero,urandom} "$root$device"
mkdir -p "$WORK/volume"
cp -a "$root$volume/." "$WORK/volume"
chown --reference="$root$volume" "$WORK/volume"
mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
for node in null zero urandom; do mount --bind "/dev/$node" "$root/dev/$node"; done
mount --bind "$port" "$root$device"
mount -t tmpfs tmpfs "$root/tmp"
mount --bind "$WORK/volume" "$root$volume"
mount -o remount,ro,bind "$root"

settings=(env -i PATH=/usr/bin)
for name in "${!environment[@]}"; do settings+=("$name=${environment[$name]}"); done
# As `exec` in the container: its user, its root, its environment.
inside() { "${settings[@]}" "$(command -v chroot)" --userspec="$id:$id" --groups="$group" "$root" "$@"; }
# Not every machine lets this be raised; the daemon does without.
limited=()
if prlimit --rtprio=1 true 2>/dev/null; then limited=(prlimit --rtprio=1); fi
# The first process of its own namespace, as in a container.
begin() {
  "${limited[@]}" setpriv --no-new-privs --bounding-set=-all,+sys_chroot,+setuid,+setgid,+sys_admin \
    "${settings[@]}" unshare --pid --fork --kill-child "$(command -v chroot)" --userspec="$id:$id" --groups="$group" "$root" \
    $entrypoint $command >"$WORK/log" 2>&1 & outer=$!
  daemon=''
  for _ in $(seq 100); do
    daemon=$(cat "/proc/$outer/task/$outer/children" 2>/dev/null | tr -d ' ') && [ -n "$daemon" ] && break
    sleep 0.1
  done
  [ -n "$daemon" ] || { cat "$WORK/log"; fail "the daemon does not begin"; }
  for _ in $(seq 200); do inside $health >"$WORK/health" 2>&1 && return; sleep 0.1; done
  cat "$WORK/log" "$WORK/health"
  fail "the health check"
}
end() {
  kill -TERM "$daemon"
  wait "$outer" || { cat "$WORK/log"; fail "the daemon ended with $?"; }
}
trap 'kill $emulator 2>/dev/null || true' EXIT

say "it begins, answers its health check and records"
! inside $health >/dev/null 2>&1 || fail "the health check holds without a daemon"
begin
grep -q "^Uid:	$id	$id	$id	$id" "/proc/$daemon/status" || fail "the daemon is not the user $id"
grep -q '^CapEff:	0*$' "/proc/$daemon/status" || fail "the daemon has capabilities"
grep -q '^NoNewPrivs:	1' "/proc/$daemon/status" || fail "the daemon may get privileges"
inside sh -c : 2>/dev/null && fail "there is a shell in the root"
printf '[http]\nlisten = "127.0.0.1:8100"\n' >"$WORK/own.toml"
! env -i "$program" --config "$WORK/own.toml" start --duration 3s >"$WORK/start" 2>&1 || fail "a change without the token"
grep -qi token "$WORK/start" || { cat "$WORK/start"; fail "the refusal does not name the token"; }
inside /usr/bin/vn100d start --duration 3s --name night >"$WORK/start" 2>&1 || { cat "$WORK/start" "$WORK/log"; fail "the start"; }
for _ in $(seq 300); do
  state=$(inside /usr/bin/vn100d --json show night 2>/dev/null | grep '"state"' || true)
  case $state in *complete*) break ;; esac
  sleep 0.1
done
case $state in *complete*) ;; *) cat "$WORK/log"; fail "the capture is not complete: $state" ;; esac
# A picture is made by a process that the daemon starts of its own program.
inside /usr/bin/vn100d plot night timeseries-gyro_x --out /tmp/picture.png || fail "no picture"

say "a stop ends it cleanly, and the next one has the data"
end
begin
inside /usr/bin/vn100d captures | grep -q night || fail "the capture is gone"
inside /usr/bin/vn100d check || fail "check finds something"
end
echo "the container is good"
