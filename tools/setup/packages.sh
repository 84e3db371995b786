#!/bin/sh
# Installs what is missing of the Debian 12 packages that a task needs: packages.sh build|test|train
# As root, or through sudo. Does nothing, and needs no network, if all are there.
set -eu

build="build-essential cmake ninja-build libfmt-dev libflatbuffers-dev flatbuffers-compiler glslang-dev glslang-tools
  spirv-tools spirv-headers nlohmann-json3-dev libcli11-dev libstb-dev libopenexr-dev libimath-dev zlib1g-dev libminizip-dev libtinygltf-dev libjs-chart.js libvulkan-dev mesa-vulkan-drivers"
# python3-torch is in both: the tests train a few steps.
train="python3 python3-numpy python3-torch python3-flatbuffers"
test="$build $train libgtest-dev libbenchmark-dev vulkan-validationlayers clang libclang-rt-14-dev valgrind"

case "${1:-}" in
  build) wanted=$build ;;
  test) wanted=$test ;;
  train) wanted=$train ;;
  *) echo "usage: $0 build|test|train" >&2; exit 2 ;;
esac

missing=
for package in $wanted; do
  dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing="$missing $package"
done
[ -n "$missing" ] || exit 0

as_root=
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "error: missing packages:$missing (run as root, or install sudo)" >&2; exit 1; }
  as_root=sudo
fi
echo "installing:$missing"
$as_root apt-get update -q
# shellcheck disable=SC2086
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing
