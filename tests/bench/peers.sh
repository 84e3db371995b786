#!/bin/sh
# The NSS networks at 960x540 by Shale and by XNNPACK, by turns, for each class of processor that the machine
# can be: as it is, and with AVX2 alone where it has AVX-512. Prints Markdown; three minutes on two cores, more on an
# empty driver cache. Needs libxnnpack-dev, libcpuinfo-dev and libpthreadpool-dev at build time.
#
#   tests/bench/peers.sh [BUILD_FOLDER]
set -eu
cd "$(dirname "$0")/../.."
bench=${1:-build}/tests/bench/peer_bench
[ -x "$bench" ] || { echo "error: $bench: not built; it needs libxnnpack-dev libcpuinfo-dev libpthreadpool-dev" >&2; exit 1; }
classes=none
grep -qs avx512vl /proc/cpuinfo && classes="none avx"
for caps in $classes; do
  [ $caps = none ] && unset GALLIUM_OVERRIDE_CPU_CAPS || export GALLIUM_OVERRIDE_CPU_CAPS=$caps
  "$bench" models/nss_v1_high models/nss_v0_1 --render 960x540 --repeat 1 >/dev/null  # fills the driver's cache
  "$bench" models/nss_v1_high models/nss_v0_1 --render 960x540 --repeat 15
  echo
done
