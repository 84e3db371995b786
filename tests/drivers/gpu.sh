#!/bin/sh
# Tries a bundle of tools/setup/bundle.sh on the GPU of a machine, within six minutes:
#   gpu.sh BUNDLE [RESULTS]     RESULTS is a JSON file, gpu_results.json by default
# SHALE_DEVICE chooses the device by a part of its name. Each step has a time of its own, so that a slow one leaves the
# others theirs; one that is cut off counts as failed. Exit code 0 if all steps succeeded.
# Example: tests/drivers/gpu.sh /tmp/shale-bundle
set -u

case "${1:-}" in
  ''|-*) sed -n '2,6s/^# //p' "$0" >&2; exit 2 ;;
esac
bundle=$(cd "$1" && pwd) || exit 2
results=${2:-gpu_results.json}
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
device=${SHALE_DEVICE:-}
deadline=$(($(date +%s) + 350))
failed=0
steps=0

# step NAME SECONDS COMMAND...    its standard output is the result: JSON, or text that is kept as such.
step() {
  name=$1 seconds=$2
  shift 2
  begin=$(date +%s)
  left=$((deadline - begin))
  [ "$seconds" -le "$left" ] || seconds=$left
  if [ "$seconds" -gt 0 ]; then
    timeout -k 5 "$seconds" "$@" > "$work/out" 2> "$work/err"
    code=$?
  else
    : > "$work/out"; echo "no time is left" > "$work/err"; code=124
  fi
  took=$(($(date +%s) - begin))
  case $code in
    0) verdict=passed ;;
    124|137) verdict="cut off after $took s" ;;
    *) verdict="failed with exit code $code" ;;
  esac
  [ "$code" -eq 0 ] || { failed=$((failed + 1)); tail -n 5 "$work/err" >&2; }
  printf '%-44s %4d s  %s\n' "$name" "$took" "$verdict"
  {
    [ "$steps" -eq 0 ] || printf ',\n'
    printf '  {"step": "%s", "exit": %d, "seconds": %d, "result": ' "$name" "$code" "$took"
    # What was cut off in the middle is no JSON.
    case $(head -c 1 "$work/out")$(tail -c 2 "$work/out" | tr -d '\n') in
      '{'*'}'|'['*']') cat "$work/out" ;;
      *) text "$work/out" ;;
    esac
    printf ', "messages": '
    text "$work/err"
    printf '}'
  } >> "$work/steps"
  steps=$((steps + 1))
}

# The last lines of a file as a JSON string.
text() {
  printf '"'
  tail -n 40 "$1" | tr -d '\000-\010\013-\037' | sed 's/\\/\\\\/g; s/"/\\"/g; s/\t/ /g' | awk '{ printf "%s\\n", $0 }'
  printf '"'
}

step doctor 20 "$bundle/shale" doctor --json
# A CPU driver, on which this script is tried, takes minutes for what a GPU is measured at and for code of its own.
size=960x540 runs=100000 target=device families="conv2d_s8_coopmat conv2d_s8_dot8"
grep -q '"kind": "GPU"' "$work/out" || { size=160x96; runs=1; target=dot8-gpu; families=conv2d_s8_dot8; }
step conform 90 "$bundle/shale" conform "$bundle/tests/golden/tosa" --backend device ${device:+"--device=$device"} --json
for test in "coopmat_test *OwnMatrices*:*Nss*" "kernels_test *dot8*:*generic*"; do
  [ -x "$bundle/bin/${test%% *}" ] || continue
  step "${test%% *}" 60 "$bundle/run" "${test%% *}" "--gtest_filter=${test#* }" --gtest_brief=1
done
for network in nss_v0_1 nss_v1_low nss_v1_high; do
  step "run $network" 20 "$bundle/shale" run "$bundle/models/$network" --input-shape input=1,64,96,12 --random 1 \
    --check ${device:+"--device=$device"} --json
done
for network in srpo_x2 srpo_x3; do
  step "run $network" 20 "$bundle/shale" run "$bundle/models/$network" --input-shape input=1,64,96,3 --random 1 \
    --check ${device:+"--device=$device"} --json
done
for sandwich in nss_v0_1 nss_v1_low nss_v1_high; do
  step "play $sandwich" 25 "$bundle/shale" play "$bundle/models/$sandwich" -i "$bundle/models/scenes/test/still.json" \
    --frames 2 --render 160x96 --expected-runs "$runs" -o "$work/$sandwich" --check ${device:+"--device=$device"} --json
done
for sandwich in srpo_x2 srpo_x3; do
  step "play $sandwich" 25 "$bundle/shale" play "$bundle/models/$sandwich" -i "$bundle/models/pictures/raster_lr.png" \
    --expected-runs "$runs" -o "$work/$sandwich.png" --check ${device:+"--device=$device"} --json
done
# Each family of GPUs beside the generic kernel, which is the naive one.
for family in $families; do
  step "bench nss_v1_high by $family" 30 "$bundle/shale" bench "$bundle/models/nss_v1_high" --render "$size" \
    --target "$target" --kernels "$family" --naive --repeat 5 ${device:+"--device=$device"} --json
done
step "bench all networks" 40 "$bundle/shale" bench "$bundle/models/nss_v0_1" "$bundle/models/nss_v1_low" \
  "$bundle/models/nss_v1_high" "$bundle/models/srpo_x2" "$bundle/models/srpo_x3" --render "$size" --target "$target" \
  --repeat 5 ${device:+"--device=$device"} --json

{
  printf '{"schema": "shale-gpu-results/1", "failed": %d, "steps": [\n' "$failed"
  cat "$work/steps"
  printf '\n]}\n'
} > "$results" || exit 1
echo "$steps steps, $failed failed; results in $results"
[ "$failed" -eq 0 ]
