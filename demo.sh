#!/bin/sh
# Installs what is missing, builds, upscales a scene in motion and measures it: ./demo.sh
# Leaves its results in out/.
set -eu
cd "$(dirname "$0")"
tools/setup/packages.sh build

cmake -S . -B build-demo -G Ninja -DCMAKE_BUILD_TYPE=Release -DSHALE_BUILD_TESTS=OFF -DSHALE_BUILD_BENCHMARKS=OFF
cmake --build build-demo --target shale
shale=build-demo/tools/shale
mkdir -p out

echo
echo "== compile NSS v1 HIGH for 960x540 -> 1920x1080"
$shale compile models/nss_v1_high --render 960x540 --output-size 1920x1080 -o out/nss_v1_high.shale

echo
echo "== render frames of a test scene, upscale them, and measure against the truth"
$shale eval models/scenes/test/motion.json -m out/nss_v1_high.shale -m models/baselines/tss \
  -m models/baselines/bilinear --frames 8 --page out/report.html --json-file out/report.json

echo
echo "== what a frame is made of, and where its time goes"
$shale play out/nss_v1_high.shale -i models/scenes/test/motion.json -o out/frames --frames 3 --profile \
  --debug-view out/debug --animation out/animation.png

echo
echo "== as many pictures again, made between the frames without a network"
$shale play models/baselines/mob_fgsr_sr_interpolation -i models/scenes/test/motion.json -o out/doubled --frames 6 \
  --render 480x270 --generate 1 --animation out/doubled.png

echo
echo "== what the network costs, and whether it fits the frame budget"
$shale report models/nss_v1_high

echo
echo "Look at:"
echo "  out/report.html    figures over time, before and after, where the methods differ"
echo "  out/animation.png  the upscaled frames, in a browser"
echo "  out/doubled.png    frames and what was made between them"
echo "  out/debug/         what the passes and the network see and say"
