/* SPDX-License-Identifier: GPL-3.0-or-later */
/* The folder of emulated devices, as both parts of the library see it. */
#include <stddef.h>
#include <sys/types.h>

#define FILES 4096
#define DEVICE "/dev/hidraw"
#define SYSTEM "/sys/class/hidraw/hidraw"

/* Path of the file of device `n` that ends on `suffix`; -1 when it is too long. */
int file_of(int n, const char *suffix, char *path, size_t size);

/* Whether that file is there. */
int has(int n, const char *suffix);

/* What is in it, up to `size` bytes; their number, or -1. */
ssize_t contents(int n, const char *suffix, void *to, size_t size);
