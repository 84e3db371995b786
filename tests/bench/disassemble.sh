#!/bin/sh
# What a driver on the CPU makes of shaders: runs a command and disassembles the machine code that lavapipe's
# LLVM makes while it runs, the driver's cache left out.
#   disassemble.sh FOLDER COMMAND...
# FOLDER gets NNNN.s for each piece of code, in the order of their compilation; a table says for each its bytes,
# its instructions, how many are of 512 and of 256 bits, multiplies, additions and loads or stores of the stack.
# GALLIUM_OVERRIDE_CPU_CAPS=avx makes a processor with AVX-512 compile for AVX2. `llvm-mca -mcpu=znver3 < loop.s`
# says what bounds a loop that was cut out of it.
# Example: tests/bench/disassemble.sh out/asm build/tools/shale bench models/nss_v1_high --render 320x180 --repeat 1
set -eu
case "${1:-}" in
  "" | -*) sed -n '2,10s/^# //p' "$0" >&2; exit 2 ;;
esac
[ $# -ge 2 ] || { sed -n '2,10s/^# //p' "$0" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1"
folder=$(cd "$1" && pwd)
shift
rm -f "$folder"/[0-9]*.bin "$folder"/[0-9]*.s
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
${CC:-cc} -O2 -shared -fPIC -o "$work/machine_code.so" "$here/machine_code.c"
SHALE_MACHINE_CODE="$folder" MESA_SHADER_CACHE_DISABLE=1 LD_PRELOAD="$work/machine_code.so" "$@"
printf '%-10s %8s %8s %8s %8s %8s %8s %8s\n' code bytes instr. zmm ymm multiply add stack
for code in "$folder"/[0-9]*.bin; do
  text=${code%.bin}.s
  objdump -D -b binary -m i386:x86-64 --no-show-raw-insn "$code" > "$text"
  # Short ones are the driver's own, for fetches and stores.
  [ "$(wc -c < "$code")" -ge 8192 ] || continue
  awk -v name="$(basename "$text")" -v bytes="$(wc -c < "$code")" '
    /^ +[0-9a-f]+:/ { n++; if (/%zmm/) zmm++; else if (/%ymm/) ymm++
      if (/\tv(p)?mul|\tvpmadd/) mul++; if (/\tv(p)?add/) add++; if (/\(%rsp\)/) stack++ }
    END { printf "%-10s %8d %8d %8d %8d %8d %8d %8d\n", name, bytes, n, zmm, ymm, mul, add, stack }' "$text"
done
