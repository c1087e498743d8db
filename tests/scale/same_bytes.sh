#!/usr/bin/env bash
# Writes what a program prints on fixed inputs into a folder: documents, exports, pages, pictures, help. Two programs that ought to
# do the same are compared with `diff -r`:
#
#   tests/scale/same_bytes.sh OLD/vn100d target/old && tests/scale/same_bytes.sh target/release/vn100d target/new
#   diff -rq target/old target/new
#
# Parquet, MCAP and the report hold the time of the run, so they always differ; all others must not.
#
# VN100D_REAL_DATA names real recordings; without them only simulated ones are used.
set -euo pipefail
program=$(realpath "$1")
mkdir -p "$2"
cd "$2"
database=$(mktemp -d)
touch "$database/empty.toml"
export VN100D_CONFIG=$database/empty.toml COLUMNS=100 TZ=UTC
trap 'rm -rf "$database"' EXIT
run() { "$program" --data-dir "$database" "$@"; }

run simulate --duration 20min --seed 7 --force --out still.csv 2>simulate.txt
run simulate --duration 2min --seed 8 --motion tumble --motion-out motion.csv --force --out moved.csv 2>>simulate.txt
cat >plain.json <<'JSON'
{"format": "vn100d-sensor-model-1", "name": "plain", "rate_hz": 40, "channels": {"gyro_x": {"N": 6e-5}, "gyro_y": {"N": 6e-5}, "gyro_z": {"N": 6e-5}, "accel_z": {"N": 1.3e-3}}}
JSON
recordings=(still.csv)
if [ -n "${VN100D_REAL_DATA:-}" ]; then
  recordings+=("$VN100D_REAL_DATA/vn100-desk/live_capture.txt.gz")
fi
number=0
for recording in "${recordings[@]}"; do
  number=$((number + 1))
  for format in table json csv kalibr openvins vins-fusion orb-slam3 lio-sam fast-lio robot-localization px4 ardupilot ros gazebo isaac gnss-ins-sim matlab; do
    run noise "$recording" --format "$format" --rate 40 >"noise-$number.$format" 2>&1 || echo "exit $?" >>"noise-$number.$format"
  done
  for estimator in oadev adev mdev hdev ohdev totdev; do
    run allan "$recording" --estimator "$estimator" --format json --rate 40 >"allan-$number.$estimator" 2>&1
  done
  for format in csv ndjson parquet mcap; do
    run export "$recording" --format "$format" --rate 40 --out "export-$number.$format" --force >"export-$number.$format.txt" 2>&1
  done
  for plot in timeseries-gyro_x histogram-accel_z allan-gyro; do
    run plot "$recording" "$plot" --rate 40 --out "$plot-$number.svg" --force >/dev/null 2>&1
  done
  run report "$recording" --rate 40 --out "report-$number.html" --force >"report-$number.txt" 2>&1
  run diagnose --real "$recording" --sim plain.json --rate 40 --json --augmented-model "augmented-$number.json" --html "diagnosis-$number.html" \
    --force >"diagnosis-$number.json" 2>&1 || echo "exit $?" >>"diagnosis-$number.json"
  run diagnose --real "$recording" --sim plain.json --rate 40 >"diagnosis-$number.txt" 2>&1 || true
done
run diagnose --real moved.csv --sim plain.json --reference motion.csv --json >moved.json 2>&1
run trial --cases 12 --seed 3 --samples 10000 --out trial --json >trial.json 2>trial.txt
run trial --motion --cases 4 --seed 3 --samples 10000 --out trial-motion --json >trial-motion.json 2>>trial.txt
run generate man man >/dev/null && run generate completions completions >/dev/null
"$program" --help >help.txt
