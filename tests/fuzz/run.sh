#!/bin/sh
# run.sh BUILD_FOLDER SECONDS [TARGET...]: fuzz targets for that long each, from seeds made of the models at hand.
# By default all but layer_fuzz, which is built when asked for by name and makes pipelines of its seeds before it begins.
set -eu
build=$1
seconds=$2
shift 2
[ $# -gt 0 ] || set -- tosa_fuzz tir_fuzz spirv_graph_fuzz vgf_fuzz package_fuzz pack_fuzz pipeline_cache_fuzz
here=$(cd "$(dirname "$0")/../.." && pwd)
corpus=$(mktemp -d)
trap 'rm -rf "$corpus"' EXIT INT TERM
tar -C "$corpus" -xJf "$here/tests/golden/tosa.tar.xz"
golden="$corpus/tosa"
find "$here/models" "$golden/graphs" "$golden/container" "$golden/const" -name '*.tosa' -size -64k 2>/dev/null | sort |
  xargs "$build/tests/fuzz/make_seeds" "$corpus"
cp "$here"/tests/golden/vgf/*.vgf "$corpus/vgf_fuzz"
cp -r "$corpus/spirv_graph_fuzz" "$corpus/layer_fuzz"
find "$corpus/layer_fuzz" -type f -size +3k -delete  # larger ones, whose kernels take seconds to minutes under sanitizers
for target in "$@"; do
  # A finding lands in the current folder.
  if ! "$build/tests/fuzz/$target" "$corpus/$target" -max_total_time="$seconds" -timeout=60 -rss_limit_mb=2048 \
    -print_final_stats=1 -verbosity=0 >"$corpus/log" 2>&1; then
    cat "$corpus/log"
    exit 1
  fi
  echo "$target: $seconds s, $(sed -n 's/stat::number_of_executed_units: *//p' "$corpus/log") inputs, no finding"
done
