// machine_code.c -- writes the code that a JIT compiler makes: preloaded by disassemble.sh, it copies
// each block of memory that becomes executable to SHALE_MACHINE_CODE/NNNN.bin.
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

int mprotect(void* address, size_t bytes, int protection) {
  static atomic_int count;
  const char* folder = getenv("SHALE_MACHINE_CODE");
  if (folder && (protection & PROT_EXEC)) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%04d.bin", folder, atomic_fetch_add(&count, 1));
    const int file = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (file < 0 || write(file, address, bytes) != (ssize_t)bytes) perror(path);
    if (file >= 0) close(file);
  }
  return (int)syscall(SYS_mprotect, address, bytes, protection);
}
