#!/bin/sh
# Measures the device at hand and writes tests/bench/RESULTS.md: layer classes by kernel_bench, networks by
# shale bench, each against the roof that was measured in the same run. Takes about 40 minutes on two cores.
#
#   [MODELS="nss_v1_high ..."] tests/bench/results.sh [BUILD_FOLDER]
#
# MODELS are the networks of the table of sizes, all by default.
set -eu
cd "$(dirname "$0")/../.."
build=${1:-build}
out=tests/bench/RESULTS.md
part=$(mktemp)
trap 'rm -f "$part" "$part.json"' EXIT

{
  echo "# Benchmark results"
  echo
  echo "Written by \`tests/bench/results.sh\` on $(date -u +%Y-%m-%d), $(nproc) cores, $(sed -n 's/^PRETTY_NAME="\(.*\)"/\1/p' /etc/os-release)."
  echo "Times are medians of device timestamps after a warm-up; GOP/s counts 2 per multiply-accumulate of the direct form,"
  echo "requantization included; the naive kernel is the generic one, one invocation per output element. The roof is"
  echo "float32 multiply and add in registers, the best of several shapes of code, measured around every run; times are taken to"
  echo "the median roof, since the machine's speed moves. A network's total is measured without timestamps between its layers."
  echo
  echo "## Layer classes"
  echo
  "$build/tests/bench/kernel_bench" 2>/dev/null | sed -n '/^| convolution/,$p'
  echo
  "$build/tools/shale" bench models/nss_v1_high --render 960x540 --start --naive --markdown
  echo
  echo "### Sizes, and predictions"
  echo
  echo "The constants of the cost model are fitted to 320x180 and 640x360 (compiler/cost/README.md). \"Close\" is the"
  echo "share of the time in dispatches that are predicted within 25 %."
  echo
  echo "| network | rendered | ms | predicted | | close | GOP/s | roof |"
  echo "|---|---|---:|---:|---:|---:|---:|---:|"
  for size in 240x136 480x270 960x540 1920x1080; do
    for model in ${MODELS:-nss_v1_high nss_v1_low nss_v0_1 srpo_x2 srpo_x3}; do
      # The first run compiles, and leaves a warm processor and the driver's disk cache.
      "$build/tools/shale" bench models/$model --render $size --repeat 1 --json >"$part.json"
      "$build/tools/shale" bench models/$model --render $size --repeat 9 --json >"$part.json"
      python3 - "$part.json" "$model" "$size" <<'END'
import json, sys
model = json.load(open(sys.argv[1]))["models"][0]
t = model["total"]
print("| %s | %s | %.1f | %.1f | %+.0f %% | %.0f %% | %.0f | %.0f |" % (sys.argv[2], sys.argv[3], t["time_ms"], t["predicted_ms"],
      100 * (t["predicted_ms"] / t["time_ms"] - 1), 100 * t["close_share"], t["gop_per_s"], model["roof_gop_per_s"]))
END
    done
  done
  for model in nss_v1_low nss_v0_1 srpo_x2; do
    "$build/tools/shale" bench models/$model --render 960x540 --markdown | sed -n '/^### /{x;p;x};/^### /,$p'
  done
  echo
  echo "## Frames"
  echo
  echo "960x540 to 1920x1080; copies are those of the host's images and the clears. By \`tests/bench/frames.sh\`."
  echo
  tests/bench/frames.sh "$build"
  if [ -x "$build/tests/bench/peer_bench" ]; then
    echo
    echo "## The peer"
    echo
    echo "The network alone, 960x540, against XNNPACK of Debian 12 on the same threads. Its INT8 is not exact."
    echo
    tests/bench/peers.sh "$build"
  fi
  echo
  echo "## The layer"
  echo
  echo "Networks by a program that knows VK_ARM_data_graph alone, and by a package. By \`tests/bench/layer.sh\`."
  echo
  tests/bench/layer.sh "$build"
} > "$part"
mv "$part" "$out"
echo "wrote $out"
