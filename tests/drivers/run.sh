#!/bin/sh
# A second driver: Debian sid's lavapipe, loader, validation layers and spirv-val, in a root that debootstrap makes.
#   run.sh [FOLDER] [GOLDEN]
# FOLDER (build-drivers by default) keeps the root, 700 MB, for the next time; GOLDEN is the folder of the TOSA cases
# (those that the build unpacks by default). SHALE_MIRROR names another mirror than debootstrap's own. Needs root, for
# debootstrap and chroot. Builds what it runs. Exit code 0 if the program, all cases and tests passed there and no module
# is invalid. Some twenty minutes on two cores.
# Example: tests/drivers/run.sh
set -eu

case "${1:-}" in
  -*) sed -n '2,8s/^# //p' "$0" >&2; exit 2 ;;
esac
source=$(cd "$(dirname "$0")/../.." && pwd)
folder=${1:-$source/build-drivers}
build=${SHALE_BUILD:-$source/build}
golden=${2:-$build/golden/tosa}

fail() { echo "error: $*" >&2; exit 1; }
[ "$(id -u)" -eq 0 ] || fail "debootstrap and chroot need root"
command -v debootstrap > /dev/null || fail "debootstrap is not installed: apt-get install debootstrap"

mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
root=$folder/root
if [ ! -e "$folder/complete" ]; then
  rm -rf "$root"
  echo "making a Debian sid root in $root"
  debootstrap --variant=minbase \
    --include=mesa-vulkan-drivers,libvulkan1,vulkan-validationlayers,vulkan-tools,spirv-tools \
    sid "$root" ${SHALE_MIRROR:+"$SHALE_MIRROR"} > "$folder/debootstrap.log" 2>&1 || fail "debootstrap failed, see $folder/debootstrap.log"
  touch "$folder/complete"
fi

cmake -S "$source" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release > "$folder/build.log"
layer_tests='alias descriptor_buffer golden graph lent optical_flow pipeline recording shader switches tensor vgf'
cmake --build "$build" --target shale kernels_test coopmat_test gpu_target_test sandwich_test VkLayer_SHALE_data_graph \
  $(printf 'layer_%s_test ' $layer_tests) >> "$folder/build.log" ||
  { tail -n 20 "$folder/build.log"; fail "the build failed, see $folder/build.log"; }
[ -d "$golden" ] || fail "$golden is not there: name the folder of the TOSA cases"
rm -rf "$root/shale" "$root/results"
mkdir "$root/results"
SHALE_BUILD=$build "$source/tools/setup/bundle.sh" "$root/shale" "$golden"
for test in gpu_target_test sandwich_test; do strip -o "$root/shale/bin/$test" "$build/tests/e2e/$test"; done
build=$(cd "$build" && pwd)
mkdir -p "$root/shale/layer/bin" "$root$build"
cp "$build"/tools/layer/VkLayer_SHALE_data_graph.* "$root/shale/layer"
for test in $layer_tests; do strip -o "$root/shale/layer/bin/$test" "$build/tests/layer/layer_${test}_test"; done
ln -sfn /shale/tests/golden "$root$build/golden"
cp "$source/tests/drivers/inside.sh" "$root/shale/inside.sh"

mounted=
unmount() {
  for mount in $mounted; do umount "$mount"; done
  mounted=
}
trap unmount EXIT
trap 'exit 130' INT TERM
mount -t proc proc "$root/proc" && mounted="$root/proc"
mount -t tmpfs tmpfs "$root/dev/shm" && mounted="$root/dev/shm $mounted"
code=0
chroot "$root" /usr/bin/env -i PATH=/usr/bin:/bin:/usr/sbin:/sbin HOME=/results sh /shale/inside.sh || code=$?
unmount
echo "outputs are in $root/results"
exit "$code"
