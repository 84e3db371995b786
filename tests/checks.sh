#!/bin/sh
# Checks that take longer than the tests, or need other builds: tests/checks.sh [CHECK...]
#   format      clang-format 14 over all C++ files
#   tidy        clang-tidy 14 over the product's sources, by .clang-tidy; FILES="a.cpp b.cpp" limits it
#   sanitize    all tests with AddressSanitizer and UndefinedBehaviorSanitizer (tools/setup: `debug` preset)
#   threads     the tests of compiler, runtime and layer, and the host program in C, with ThreadSanitizer
#   no-vulkan   the compiler and its tests in a build without the Vulkan runtime
# Without arguments: all of them. A check that finds something makes the script fail, the others run all the same.
set -eu
cd "$(dirname "$0")/.."
jobs=${JOBS:-$(nproc)}

sources() { git ls-files -- 'ir/*.cpp' 'compiler/*.cpp' 'runtime/*.cpp' 'tools/*.cpp'; }

check_format() {
  git ls-files -- '*.cpp' '*.h' '*.c' | xargs -P "$jobs" -n 16 clang-format --dry-run --Werror
}

check_tidy() {
  cmake -S . -B build-tidy -G Ninja -DCMAKE_BUILD_TYPE=Release >/dev/null
  # Sources include what the build generates.
  cmake --build build-tidy --target shale_schema_tosa shale_schema_vgf shale_schema_package
  for target in $(ninja -C build-tidy -t targets all | sed -n 's/^\(generated\/[^:]*\.h\): CUSTOM_COMMAND.*/\1/p'); do
    ninja -C build-tidy "$target" >/dev/null
  done
  # shellcheck disable=SC2086
  { [ -n "${FILES:-}" ] && printf '%s\n' $FILES || sources; } |
    xargs -P "$jobs" -n 1 clang-tidy -p build-tidy --quiet 2>/dev/null
}

# tests FOLDER FLAGS TARGETS... -- CTEST_ARGUMENTS...
check_build() {
  folder=$1 flags=$2
  shift 2
  cmake -S . -B "$folder" -G Ninja -DCMAKE_BUILD_TYPE=Debug -DSHALE_BUILD_BENCHMARKS=OFF -DSHALE_WARNINGS_AS_ERRORS=OFF \
    -DCMAKE_CXX_FLAGS="$flags" -DCMAKE_C_FLAGS="$flags" "$@" >/dev/null
}

check_sanitize() {
  # Without vptr: the libraries have no type information.
  check_build build-sanitize "-O1 -fsanitize=address,undefined -fno-sanitize=vptr -fno-sanitize-recover=undefined -fno-omit-frame-pointer"
  cmake --build build-sanitize
  # Drivers and OpenEXR keep memory until the end of the process.
  ASAN_OPTIONS=detect_leaks=0:strict_string_checks=1 UBSAN_OPTIONS=print_stacktrace=1 \
    ctest --test-dir build-sanitize --output-on-failure -j "$jobs" -LE '(python|valgrind)'
}

check_threads() {
  check_build build-threads "-O1 -fsanitize=thread -fno-omit-frame-pointer"
  targets="host_program $(ninja -C build-threads -t targets all |
    sed -n 's/^tests\/\(runtime\|compiler\|layer\)\/\([a-z_0-9]*_test\): CXX_EXECUTABLE.*/\2/p')"
  # shellcheck disable=SC2086
  cmake --build build-threads --target $targets
  TSAN_OPTIONS="suppressions=$PWD/tests/support/tsan.supp second_deadlock_stack=1" \
    ctest --test-dir build-threads --output-on-failure -j 1 -R "^($(echo $targets | tr ' ' '|'))\$"
}

check_no_vulkan() {
  check_build build-no-vulkan "-O1" -DSHALE_BUILD_RUNTIME=OFF
  cmake --build build-no-vulkan
  ctest --test-dir build-no-vulkan --output-on-failure -j "$jobs"
}

[ $# -gt 0 ] || set -- format tidy no-vulkan threads sanitize
failed=
for check in "$@"; do
  case $check in
    format | tidy | sanitize | threads | no-vulkan) ;;
    *) echo "usage: $0 [format|tidy|sanitize|threads|no-vulkan]..." >&2; exit 2 ;;
  esac
done
for check in "$@"; do
  echo "== $check"
  set +e  # a condition would switch it off inside
  (set -e; "check_$(echo "$check" | tr - _)")
  status=$?
  set -e
  if [ $status -eq 0 ]; then echo "$check: passed"; else failed="$failed $check"; fi
done
[ -z "$failed" ] || { echo "failed:$failed" >&2; exit 1; }
