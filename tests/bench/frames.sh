#!/bin/sh
# Measures whole frames of the NSS sandwiches, 960x540 to 1920x1080, and prints a table in Markdown: medians of 20 runs of one
# frame of a test scene, one after the other; the better of two such runs. Takes some five minutes on two cores.
#
#   tests/bench/frames.sh [BUILD_FOLDER]
set -eu
cd "$(dirname "$0")/../.."
shale=${1:-build}/tools/shale
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$shale" scene models/scenes/test/motion.json -o "$work/scene" --frames 2 --no-truth >/dev/null
echo "| sandwich | copies | before the network | network | after | a frame, ms | passes |"
echo "|---|---:|---:|---:|---:|---:|---:|"
for model in nss_v1_high nss_v1_low nss_v0_1; do
  "$shale" compile models/$model --render 960x540 --output-size 1920x1080 -o "$work/package.shale" >/dev/null
  for run in 1 2; do
    "$shale" play "$work/package.shale" -i "$work/scene" -o "$work/frames" --profile --repeat 20 --json >"$work/$run.json"
  done
  python3 - $model "$work/1.json" "$work/2.json" <<'END'
import json, sys
runs = [json.load(open(path)) for path in sys.argv[2:]]
best = min(runs, key=lambda run: run["frame_us"])
copies = before = network = after = 0.0
for time in best["dispatches"]:
    ms = time["time_us"] / 1000
    if time["kernel"] in ("copy", "clear"): copies += ms
    elif time["segment"] == "graph": network += ms
    elif network: after += ms
    else: before += ms
frame = copies + before + network + after
print("| %s | %.1f | %.1f | %.1f | %.1f | %.1f | %.0f %% |" % (sys.argv[1], copies, before, network, after, frame,
      100 * (frame - network) / frame))
END
done
