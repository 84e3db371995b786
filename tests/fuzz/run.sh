#!/bin/sh
# run.sh BUILD_FOLDER SECONDS: every fuzz target for that long, from seeds made of the models at hand.
set -eu
build=$1
seconds=$2
here=$(cd "$(dirname "$0")/../.." && pwd)
corpus=$(mktemp -d)
trap 'rm -rf "$corpus"' EXIT INT TERM
golden="$here/../shared/golden/tosa"
find "$here/models" "$golden/graphs" "$golden/container" "$golden/const" -name '*.tosa' -size -64k 2>/dev/null | sort |
  xargs "$build/tests/fuzz/make_seeds" "$corpus"
for target in tosa_fuzz tir_fuzz package_fuzz pipeline_cache_fuzz; do
  echo "== $target, $seconds s"
  # A finding lands in the current folder and ends the script with the fuzzer's exit code.
  "$build/tests/fuzz/$target" "$corpus/$target" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 \
    -print_final_stats=1 -verbosity=0
done
