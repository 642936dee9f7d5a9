/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Preloaded into a program, this shows the devices of a folder as /dev/hidraw<N>: the calls that hidapi makes (and
 * Python's os.access) reach a socket there instead of a kernel driver. The folder is REPOUSSE_FAKEHID; in it are, of
 * each device, `hidraw<N>`: a SOCK_SEQPACKET socket, a packet a report; `hidraw<N>.descriptor` and `hidraw<N>.uevent`:
 * what the kernel says of it in /sys/class/hidraw/hidraw<N>/device/. `hidraw<N>.denied` stands for a node that may not
 * be opened.
 *
 * Like linux/drivers/hid/hidraw.c: a write of a device that is gone fails with ENODEV, and so does its ioctl; a write
 * of less than two bytes or more than HID_MAX_BUFFER_SIZE with EINVAL.
 */
#define _GNU_SOURCE
#include "node.h"
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/hidraw.h>
#include <poll.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#define DESCRIPTOR "/device/report_descriptor"
#define UEVENT "/device/uevent"
#define LARGEST_WRITE 16384 /* HID_MAX_BUFFER_SIZE of include/linux/hid.h */

/* Number of the device that a file descriptor is, plus one; 0 for what is not ours. */
static atomic_int device_of[FILES];

static int next_open(const char *path, int flags, mode_t mode) {
    static int (*next)(const char *, int, ...);
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, "open");
    return next(path, flags, mode);
}

static int next_access(const char *path, int mode) {
    static int (*next)(const char *, int);
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, "access");
    return next(path, mode);
}

/* Number at the end of `path` after `prefix`, followed by `suffix`; -1 for any other path, or without a folder. */
static int number(const char *path, const char *prefix, const char *suffix) {
    size_t length = strlen(prefix);
    char *end;
    long value;

    if (!getenv("REPOUSSE_FAKEHID") || strncmp(path, prefix, length) || path[length] < '0' || path[length] > '9')
        return -1;
    value = strtol(path + length, &end, 10);
    return value < FILES && !strcmp(end, suffix) ? (int)value : -1;
}

int file_of(int n, const char *suffix, char *path, size_t size) {
    const char *folder = getenv("REPOUSSE_FAKEHID");
    if (folder && snprintf(path, size, "%s/hidraw%d%s", folder, n, suffix) < (int)size) return 0;
    errno = ENOENT;
    return -1;
}

int has(int n, const char *suffix) {
    char path[PATH_MAX];
    return !file_of(n, suffix, path, sizeof path) && !next_access(path, F_OK);
}

static int permitted(int n) {
    if (has(n, ".denied")) {
        errno = EACCES;
        return -1;
    }
    if (!has(n, "")) {
        errno = ENOENT;
        return -1;
    }
    return 0;
}

static int connect_to(int n) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    int descriptor;

    if (permitted(n) || file_of(n, "", address.sun_path, sizeof address.sun_path)) return -1;
    descriptor = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    if (descriptor < 0) return -1;
    if (descriptor >= FILES || connect(descriptor, (struct sockaddr *)&address, sizeof address)) {
        close(descriptor);
        errno = ENODEV;
        return -1;
    }
    device_of[descriptor] = n + 1;
    return descriptor;
}

static int any_open(const char *path, int flags, mode_t mode) {
    char file[PATH_MAX];
    int n;

    if ((n = number(path, DEVICE, "")) >= 0) return connect_to(n);
    if ((n = number(path, SYSTEM, DESCRIPTOR)) >= 0)
        return file_of(n, ".descriptor", file, sizeof file) ? -1 : next_open(file, flags, mode);
    if ((n = number(path, SYSTEM, UEVENT)) >= 0)
        return file_of(n, ".uevent", file, sizeof file) ? -1 : next_open(file, flags, mode);
    return next_open(path, flags, mode);
}

#define OPEN(name, extra)                                                                                              \
    int name(const char *path, int flags, ...) {                                                                       \
        mode_t mode = 0;                                                                                               \
        va_list arguments;                                                                                             \
        va_start(arguments, flags);                                                                                    \
        if (flags & (O_CREAT | __O_TMPFILE)) mode = va_arg(arguments, mode_t);                                         \
        va_end(arguments);                                                                                             \
        return any_open(path, flags | (extra), mode);                                                                  \
    }

OPEN(open, 0)
OPEN(open64, O_LARGEFILE)

int access(const char *path, int mode) {
    int n = number(path, DEVICE, "");
    return n >= 0 ? permitted(n) : next_access(path, mode);
}

static int mine(int descriptor) { return descriptor >= 0 && descriptor < FILES ? device_of[descriptor] - 1 : -1; }

/* As the kernel's: a device that is gone knows nothing any more. */
static int gone(int descriptor) {
    struct pollfd file = {.fd = descriptor};
    return poll(&file, 1, 0) > 0 && file.revents & (POLLHUP | POLLERR);
}

ssize_t contents(int n, const char *suffix, void *to, size_t size) {
    char path[PATH_MAX];
    ssize_t length = -1;
    int file;

    if (file_of(n, suffix, path, sizeof path) || (file = next_open(path, O_RDONLY | O_CLOEXEC, 0)) < 0) return -1;
    length = read(file, to, size);
    close(file);
    return length;
}

static int answer(int descriptor, int n, unsigned long request, void *to) {
    unsigned char bytes[HID_MAX_DESCRIPTOR_SIZE];
    char text[64] = "";
    ssize_t length;

    if (gone(descriptor)) {
        errno = ENODEV;
        return -1;
    }
    if (request == HIDIOCGRDESCSIZE || request == HIDIOCGRDESC) {
        struct hidraw_report_descriptor *report = to;
        if ((length = contents(n, ".descriptor", bytes, sizeof bytes)) < 0) return -1;
        if (request == HIDIOCGRDESCSIZE) *(int *)to = (int)length;
        else memcpy(report->value, bytes, report->size < length ? report->size : (size_t)length);
        return 0;
    }
    if (request == HIDIOCGRAWINFO) {
        unsigned bus, vendor, product;
        if (contents(n, ".uevent", text, sizeof text - 1) < 0 ||
            sscanf(text, "HID_ID=%x:%x:%x", &bus, &vendor, &product) != 3)
            return -1;
        *(struct hidraw_devinfo *)to = (struct hidraw_devinfo){bus, (short)vendor, (short)product};
        return 0;
    }
    errno = EINVAL; /* no feature reports */
    return -1;
}

int ioctl(int descriptor, unsigned long request, ...) {
    static int (*next)(int, unsigned long, ...);
    int n = mine(descriptor);
    va_list arguments;
    void *to;

    va_start(arguments, request);
    to = va_arg(arguments, void *);
    va_end(arguments);
    if (n >= 0) return answer(descriptor, n, request, to);
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, "ioctl");
    return next(descriptor, request, to);
}

ssize_t write(int descriptor, const void *data, size_t size) {
    static ssize_t (*next)(int, const void *, size_t);
    ssize_t sent;

    if (mine(descriptor) < 0) {
        if (!next) *(void **)&next = dlsym(RTLD_NEXT, "write");
        return next(descriptor, data, size);
    }
    if (size < 2 || size > LARGEST_WRITE) {
        errno = EINVAL;
        return -1;
    }
    sent = send(descriptor, data, size, MSG_NOSIGNAL);
    if (sent < 0 && (errno == EPIPE || errno == ECONNRESET)) errno = ENODEV;
    return sent;
}

int close(int descriptor) {
    static int (*next)(int);
    if (mine(descriptor) >= 0) device_of[descriptor] = 0;
    if (!next) *(void **)&next = dlsym(RTLD_NEXT, "close");
    return next(descriptor);
}
