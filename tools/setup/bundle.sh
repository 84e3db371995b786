#!/bin/sh
# Puts the program, its libraries, the models and the cases of the tests into a folder that runs on any x86-64 Linux
# whose C library is Debian 12's (glibc 2.36) or newer: bundle.sh FOLDER [GOLDEN]
# GOLDEN is the folder of the TOSA cases (those that the build unpacks by default). Build the program before (build/, or what
# SHALE_BUILD names); kernel and sandwich tests come along where they are built. At most 60 MiB, or it is an error.
# Example: tools/setup/bundle.sh /tmp/shale-bundle && /tmp/shale-bundle/shale doctor
set -eu

case "${1:-}" in
  ''|-*) sed -n '2,6s/^# //p' "$0" >&2; exit 2 ;;
esac
source=$(cd "$(dirname "$0")/../.." && pwd)
build=${SHALE_BUILD:-$source/build}
golden=${2:-$build/golden/tosa}
out=$1
limit_mib=60

fail() { echo "error: $*" >&2; exit 1; }
[ -x "$build/tools/shale" ] || fail "$build/tools/shale is not there: cmake --build $build --target shale"
[ -d "$golden" ] || fail "$golden is not there: name the folder of the TOSA cases"
[ ! -e "$out" ] || [ -z "$(ls -A "$out")" ] || fail "$out is not empty"

mkdir -p "$out/bin" "$out/lib" "$out/fallback" "$out/tests/golden"
out=$(cd "$out" && pwd)
for file in tools/shale tests/compiler/kernels_test tests/compiler/coopmat_test; do
  if [ -x "$build/$file" ]; then strip -o "$out/bin/${file##*/}" "$build/$file"; fi
done

# Not the C library, which belongs to the machine. Libraries that its Vulkan driver may need in a newer version are
# taken from the machine if it has them.
for file in "$out"/bin/*; do ldd "$file"; done | sort -u | while read -r name arrow path rest; do
  [ "$arrow" = "=>" ] || continue
  case $name in
    libc.so.*|libm.so.*|libdl.so.*|libpthread.so.*|librt.so.*) continue ;;
    libstdc++.so.*|libgcc_s.so.*|libz.so.*|libvulkan.so.*) mkdir -p "$out/fallback/$name" && cp -L "$path" "$out/fallback/$name" ;;
    *) cp -L "$path" "$out/lib/$name" ;;
  esac
done
# The loader is opened by name where the program does not link it.
if [ ! -d "$out/fallback/libvulkan.so.1" ]; then
  loader=$(ldconfig -p 2>/dev/null | sed -n 's/.*libvulkan\.so\.1 .*x86-64.* => //p' | head -n 1)
  [ -z "$loader" ] || { mkdir -p "$out/fallback/libvulkan.so.1" && cp -L "$loader" "$out/fallback/libvulkan.so.1/libvulkan.so.1"; }
fi

cat > "$out/run" <<'END'
#!/bin/sh
# Runs a program of bin/ with the libraries beside it: run PROGRAM [ARGUMENT...]
here=$(cd "$(dirname "$0")" && pwd)
libraries=$here/lib
known=$( (ldconfig -p || /sbin/ldconfig -p) 2>/dev/null || true)
for folder in "$here"/fallback/*; do
  case $known in
    *"${folder##*/}"*) ;;
    *) libraries=$libraries:$folder ;;
  esac
done
cases=$here/tests/golden
if [ ! -d "$cases/tosa" ]; then
  rm -rf "$cases/part" && mkdir "$cases/part" && tar -C "$cases/part" -xzf "$cases/tosa.tar.gz" && mv "$cases/part" "$cases/tosa"
fi
program=$1
shift
SHALE_SOURCES=$here LD_LIBRARY_PATH=$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} exec "$here/bin/$program" "$@"
END
cat > "$out/shale" <<'END'
#!/bin/sh
exec "$(dirname "$0")/run" shale "$@"
END
chmod +x "$out/run" "$out/shale"

# Not what only training reads, and of the QRISP networks the smallest, which has the operators of all.
(cd "$source" && tar -c --exclude='weights*.npz' --exclude=models/qrisp_m_x2 --exclude=models/qrisp_s_x3 models shaders) | tar -x -C "$out"
tar -C "$golden" -czf "$out/tests/golden/tosa.tar.gz" .  # unpacked by the first run
find "$out" -name __pycache__ -prune -exec rm -r {} +

mib=$(du -sm --apparent-size "$out" | cut -f 1)
[ "$mib" -le "$limit_mib" ] || fail "$out takes $mib MiB, expected at most $limit_mib"
echo "$out: $mib MiB"
