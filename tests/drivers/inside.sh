#!/bin/sh
# What run.sh runs inside of the root: a bundle lies in /shale, outputs go to /results.
set -u
cd /results || exit 1
failed=0

# check NAME COMMAND...    output goes to NAME.log
check() {
  name=$1
  shift
  begin=$(date +%s)
  # In a shell of its own: functions share their variables.
  if ("$@") > "$name.log" 2>&1; then verdict=passed; else verdict="failed with exit code $?"; failed=$((failed + 1)); fi
  printf '%-28s %5d s  %s; %s\n' "$name" "$(($(date +%s) - begin))" "$verdict" "$(tail -n 1 "$name.log" | cut -c 1-100)"
}

# A test program of which nothing may be skipped: for what the other driver lacks.
really() {
  /shale/run "$@" > really.log 2>&1
  code=$?
  cat really.log
  [ "$code" -eq 0 ] && ! grep -q SKIPPED really.log
}

shale() { /shale/shale "$@"; }

# modules FOLDER    spirv-val over all modules below it, as many at a time as there are processors
modules() {
  count=$(find "$1" -name '*.spv' | wc -l)
  [ "$count" -gt 0 ] || { echo "there are no modules in $1"; return 1; }
  find "$1" -name '*.spv' -print0 |
    xargs -0 -n 1 -P "$(nproc)" sh -c 'spirv-val --target-env "$0" "$1" > "$1.txt" 2>&1 || { echo "$1"; cat "$1.txt"; }' "$2" \
    > "$1.invalid"
  invalid=$(grep -c '\.spv$' "$1.invalid")
  cat "$1.invalid"
  echo "$count modules, $invalid invalid"
  [ "$invalid" -eq 0 ]
}

# Every TOSA case for all targets, and as a graph module.
compile_cases() {
  find /shale/tests/golden/tosa -name '*.tosa' > cases.txt
  mkdir -p modules/cases graphs/cases
  # What a target cannot take is refused before there is code: conform says whether that is right.
  xargs -n 1 -P "$(nproc)" sh -c '
    name=$(dirname "$0" | sed "s:^/shale/tests/golden/tosa/::; s:/:_:g")
    /shale/shale compile "$0" --target all -o "$name.shale" > /dev/null 2>> refused.txt &&
      /shale/shale dump "$name.shale" --modules "modules/cases/$name" > /dev/null
    /shale/shale convert "$0" -o "graphs/cases/$name.spv" > /dev/null 2>> refused.txt
    rm -f "$name.shale"; true' < cases.txt
  echo "$(wc -l < cases.txt) cases, $(wc -l < refused.txt) refused"
}

# Every model and sandwich for all targets, and its graph.
compile_models() {
  mkdir -p modules/models graphs/models
  for model in /shale/models/*/ /shale/models/baselines/*/; do
    [ -e "$model/frame.json" ] || continue
    name=$(basename "$model")
    shale compile "$model" --target all -o "$name.shale" || return
    shale dump "$name.shale" --modules "modules/models/$name" || return
    for network in "$model"/*.tosa; do
      [ -e "$network" ] || continue
      shale convert "$network" -o "graphs/models/$name-$(basename "$network" .tosa).spv" || return
    done
  done
}

# A client on the layer, with validation that knows both extensions above it.
layer() {
  VK_LAYER_PATH=/shale/layer:/usr/share/vulkan/explicit_layer.d SHALE_LAYER_CACHE=off SHALE_VALIDATED=1 \
    VK_INSTANCE_LAYERS=VK_LAYER_KHRONOS_validation:VK_LAYER_SHALE_data_graph VK_LAYER_VALIDATE_SYNC=1 \
    LD_LIBRARY_PATH=/shale/lib SHALE_SOURCES=/shale "$@"
}

: > refused.txt
vulkaninfo --summary 2> /dev/null | sed -n 's/^[[:space:]]*\(deviceName\|driverInfo\) *= /\1: /p'
spirv-val --version | head -n 1
check doctor shale doctor --json
check conform shale conform /shale/tests/golden/tosa --backend device --validation
check conform_without_passes shale conform /shale/tests/golden/tosa --backend device --validation --no-passes --no-spirv-opt
check matrices really coopmat_test --gtest_filter='*OwnMatrices*'
for program in /shale/layer/bin/*; do check "layer_$(basename "$program")" layer "$program"; done
for test in coopmat_test kernels_test gpu_target_test sandwich_test; do check "$test" /shale/run "$test"; done
check compile_models compile_models
check compile_cases compile_cases
check shaders modules modules vulkan1.3
check graphs modules graphs vulkan1.3
[ "$failed" -eq 0 ] && echo "all passed" || echo "$failed failed"
[ "$failed" -eq 0 ]
