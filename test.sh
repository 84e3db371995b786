#!/bin/sh
# Installs what is missing, builds everything and runs all tests: ./test.sh
set -eu
cd "$(dirname "$0")"
tools/setup/packages.sh test

cmake -S . -B build -G Ninja -DCMAKE_BUILD_TYPE=Release
cmake --build build

# The fuzz targets need clang; each runs its seeds and a few thousand mutations here.
cmake -S . -B build-fuzz -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_C_COMPILER=clang \
  -DCMAKE_CXX_COMPILER=clang++ -DSHALE_BUILD_FUZZERS=ON -DSHALE_BUILD_TESTS=OFF -DSHALE_BUILD_BENCHMARKS=OFF
cmake --build build-fuzz --target fuzzers
tests/fuzz/run.sh build-fuzz 5

ctest --test-dir build --output-on-failure -j "$(nproc)"
