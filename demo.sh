#!/bin/sh
# Installs what is missing, builds, and runs the bundled network on a bundled picture: ./demo.sh
# Leaves its results in out/.
set -eu
cd "$(dirname "$0")"
tools/setup/packages.sh build

cmake -S . -B build-demo -G Ninja -DCMAKE_BUILD_TYPE=Release -DSHALE_BUILD_TESTS=OFF -DSHALE_BUILD_BENCHMARKS=OFF
cmake --build build-demo --target shale
shale=build-demo/tools/shale
mkdir -p out

echo
echo "== compile models/srpo_x2 for a 480x270 picture"
$shale compile models/srpo_x2 --render 480x270 -o out/srpo_x2.shale

echo
echo "== run its sandwich on models/pictures/raster_lr.png"
$shale play out/srpo_x2.shale -i models/pictures/raster_lr.png -o out/result.png \
  --reference models/pictures/raster_x2.png --compare out/side_by_side.png --profile
$shale play out/srpo_x2.shale -i models/pictures/raster_lr.png -o out/result.png \
  --reference models/pictures/raster_x2.png --compare out/zoom.png --crop 130,120,200,120 --zoom 4 >/dev/null

echo
echo "== what it costs at 960x540 -> 1920x1080"
$shale report models/srpo_x2 --render 960x540

echo
echo "Look at:"
echo "  out/side_by_side.png  input, nearest, Lanczos and network"
echo "  out/zoom.png          a part of it, four times as large, with the reference"
