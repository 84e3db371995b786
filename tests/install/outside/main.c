/* An outside program in C: what the installed library tells of bad input. */
#include <shale/shale.h>
#include <stdio.h>
#include <string.h>

int main(void) {
  ShaleError error = {.struct_size = sizeof(error)};
  ShalePackage* package = NULL;
  const char text[] = "no package";
  const ShaleResult result = shale_package_read(text, sizeof(text), &package, &error);
  puts(error.text);
  return result == SHALE_BAD_INPUT && package == NULL && strstr(error.text, ".shale") ? 0 : 1;
}
