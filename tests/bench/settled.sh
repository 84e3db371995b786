#!/bin/sh
# What settled tiles save, for NSS v1 HIGH and LOW at 960x540: the test scene `still` without what turns in it, a cycle of its
# jitter, in which a square of 0 to 100 % of the picture scrolls; then the quality at rest. Prints Markdown; ten minutes on two cores.
#
#   tests/bench/settled.sh [BUILD_FOLDER]
set -eu
cd "$(dirname "$0")/../.."
build=${1:-build}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 130' INT TERM
python3 - models/scenes/test/still.json "$folder/rest.json" <<'END'
import json, sys
def at_rest(value):
    if isinstance(value, dict):
        return {name: at_rest(part) for name, part in value.items() if name != "animate"}
    return [at_rest(part) for part in value] if isinstance(value, list) else value
json.dump(at_rest(json.load(open(sys.argv[1]))), open(sys.argv[2], "w"))
END
"$build/tools/shale" scene "$folder/rest.json" -o "$folder/frames" --frames 32 >/dev/null
for model in nss_v1_high nss_v1_low; do
  "$build/tools/shale" compile "models/$model" --render 960x540 --target device -o "$folder/$model.whole.shale" >/dev/null
  "$build/tools/shale" compile "models/$model" --render 960x540 --target device --tiles 8 -o "$folder/$model.shale" >/dev/null
  set -- "$folder/$model.shale" "$folder/$model.whole.shale" "$folder"/frames/*.json
  # The first run compiles, and leaves the driver's disk cache.
  for turns in 1 0 5; do
    "$build/tests/bench/settled_bench" "$@" $turns >"$folder/table"
    [ $turns = 1 ] || sed "s|$folder/||g" "$folder/table"
    echo
  done
done
