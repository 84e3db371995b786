#!/bin/sh
# Measures the device at hand and writes tests/bench/RESULTS.md: layer classes by kernel_bench, networks by
# shale bench, each against the roof that was measured in the same run. Takes about ten minutes on two cores.
#
#   tests/bench/results.sh [BUILD_FOLDER]
set -eu
cd "$(dirname "$0")/../.."
build=${1:-build}
out=tests/bench/RESULTS.md
part=$(mktemp)
trap 'rm -f "$part"' EXIT

{
  echo "# Benchmark results"
  echo
  echo "Written by \`tests/bench/results.sh\` on $(date -u +%Y-%m-%d), $(nproc) cores, $(sed -n 's/^PRETTY_NAME="\(.*\)"/\1/p' /etc/os-release)."
  echo "Times are medians of device timestamps after a warm-up; GOP/s counts 2 per multiply-accumulate of the direct form,"
  echo "requantization included; the naive kernel is the generic one, one invocation per output element. The roof is"
  echo "float32 multiply and add in registers, the best of several shapes of code, measured just before and after each."
  echo
  echo "## Layer classes"
  echo
  "$build/tests/bench/kernel_bench" 2>/dev/null | sed -n '/^| convolution/,$p'
  echo
  "$build/tools/shale" bench models/nss_v1_high --render 960x540 --start --naive --markdown
  echo
  echo "### Sizes"
  echo
  echo "| NSS v1 HIGH | ms | GOP/s |"
  echo "|---|---:|---:|"
  for size in 240x136 480x272 960x544 1920x1088; do
    "$build/tools/shale" bench models/nss_v1_high --render $size --json |
      python3 -c "import json,sys; t=json.load(sys.stdin)['models'][0]['total']; print('| $size | %.1f | %.1f |' % (t['time_ms'], t['gop_per_s']))"
  done
  "$build/tools/shale" bench models/nss_v1_low --render 960x540 --markdown | sed -n '/^### /{x;p;x};/^### /,$p'
  "$build/tools/shale" bench models/nss_v0_1 --render 960x540 --markdown | sed -n '/^### /{x;p;x};/^### /,$p'
  "$build/tools/shale" bench models/srpo_x2 --render 960x540 --markdown | sed -n '/^### /{x;p;x};/^### /,$p'
} > "$part"
mv "$part" "$out"
trap - EXIT
echo "wrote $out"
