/* SPDX-License-Identifier: GPL-3.0-or-later */
/* The part of libudev that hidapi lists devices with, for the devices of REPOUSSE_FAKEHID (see fakehid.c). A program
 * that has a libudev of its own (Debian's Blender does, by libusb) keeps it: the wheel's is private to the wheel.
 */
#define _GNU_SOURCE
#include "node.h"
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PASS(result, name, types, ...)                                                                                 \
    do {                                                                                                               \
        result(*next) types;                                                                                           \
        *(void **)&next = dlsym(RTLD_NEXT, #name);                                                                     \
        if (next) return next(__VA_ARGS__);                                                                            \
    } while (0)

/* Zeros, and more than the real one has: libusb hands it to functions of the real libudev. */
struct udev {
    char unused[4096];
};

struct udev_list_entry {
    int number;
    char path[64];
};

struct udev_enumerate {
    struct udev_list_entry entries[FILES + 1]; /* those that are there in order, then one with the number -1 */
};

enum level { RAW, HID, INTERFACE, USB, LEVELS };

struct udev_device {
    enum level level;
    int number;
    char path[64], node[64], text[1024];
    struct udev_device *levels; /* all four of this device, which live and die as one */
};

static struct udev context;

static struct udev_device *new_device(int number) {
    struct udev_device *levels = has(number, "") ? calloc(LEVELS, sizeof *levels) : NULL;
    if (!levels) return NULL;
    for (int level = 0; level < LEVELS; level++)
        levels[level] = (struct udev_device){.level = level, .number = number, .levels = levels};
    return &levels[RAW];
}

struct udev *udev_new(void) {
    PASS(struct udev *, udev_new, (void), );
    return &context;
}

struct udev *udev_unref(struct udev *udev) {
    PASS(struct udev *, udev_unref, (struct udev *), udev);
    return NULL;
}

struct udev_enumerate *udev_enumerate_new(struct udev *udev) {
    PASS(struct udev_enumerate *, udev_enumerate_new, (struct udev *), udev);
    return calloc(1, sizeof(struct udev_enumerate));
}

struct udev_enumerate *udev_enumerate_unref(struct udev_enumerate *enumerate) {
    PASS(struct udev_enumerate *, udev_enumerate_unref, (struct udev_enumerate *), enumerate);
    free(enumerate);
    return NULL;
}

int udev_enumerate_add_match_subsystem(struct udev_enumerate *enumerate, const char *subsystem) {
    PASS(int, udev_enumerate_add_match_subsystem, (struct udev_enumerate *, const char *), enumerate, subsystem);
    return 0;
}

int udev_enumerate_scan_devices(struct udev_enumerate *enumerate) {
    PASS(int, udev_enumerate_scan_devices, (struct udev_enumerate *), enumerate);
    struct udev_list_entry *entry = enumerate->entries;
    for (int n = 0; n < 64; n++) {
        if (!has(n, "")) continue;
        entry->number = n;
        snprintf(entry->path, sizeof entry->path, SYSTEM "%d", n);
        entry++;
    }
    entry->number = -1;
    return 0;
}

static struct udev_list_entry *listed(struct udev_list_entry *entry) { return entry->number < 0 ? NULL : entry; }

struct udev_list_entry *udev_enumerate_get_list_entry(struct udev_enumerate *enumerate) {
    PASS(struct udev_list_entry *, udev_enumerate_get_list_entry, (struct udev_enumerate *), enumerate);
    return listed(enumerate->entries);
}

struct udev_list_entry *udev_list_entry_get_next(struct udev_list_entry *entry) {
    PASS(struct udev_list_entry *, udev_list_entry_get_next, (struct udev_list_entry *), entry);
    return listed(entry + 1);
}

const char *udev_list_entry_get_name(struct udev_list_entry *entry) {
    PASS(const char *, udev_list_entry_get_name, (struct udev_list_entry *), entry);
    return entry->path;
}

struct udev_device *udev_device_new_from_syspath(struct udev *udev, const char *path) {
    PASS(struct udev_device *, udev_device_new_from_syspath, (struct udev *, const char *), udev, path);
    return strncmp(path, SYSTEM, strlen(SYSTEM)) ? NULL : new_device(atoi(path + strlen(SYSTEM)));
}

/* hidapi asks for the device of an open file, and a socket does not know its number: the first one is taken. */
struct udev_device *udev_device_new_from_devnum(struct udev *udev, char type, dev_t number) {
    PASS(struct udev_device *, udev_device_new_from_devnum, (struct udev *, char, dev_t), udev, type, number);
    for (int n = 0; n < 64; n++)
        if (has(n, "")) return new_device(n);
    return NULL;
}

struct udev_device *udev_device_unref(struct udev_device *device) {
    PASS(struct udev_device *, udev_device_unref, (struct udev_device *), device);
    if (device) free(device->levels);
    return NULL;
}

struct udev_device *udev_device_get_parent_with_subsystem_devtype(struct udev_device *device, const char *subsystem,
                                                                  const char *type) {
    PASS(struct udev_device *, udev_device_get_parent_with_subsystem_devtype,
         (struct udev_device *, const char *, const char *), device, subsystem, type);
    if (!strcmp(subsystem, "hid")) return &device->levels[HID];
    if (!strcmp(subsystem, "usb") && type) return &device->levels[strcmp(type, "usb_device") ? INTERFACE : USB];
    return NULL;
}

const char *udev_device_get_devnode(struct udev_device *device) {
    PASS(const char *, udev_device_get_devnode, (struct udev_device *), device);
    snprintf(device->node, sizeof device->node, DEVICE "%d", device->number);
    return device->node;
}

const char *udev_device_get_syspath(struct udev_device *device) {
    PASS(const char *, udev_device_get_syspath, (struct udev_device *), device);
    snprintf(device->path, sizeof device->path, SYSTEM "%d", device->number);
    return device->path;
}

const char *udev_device_get_sysattr_value(struct udev_device *device, const char *name) {
    PASS(const char *, udev_device_get_sysattr_value, (struct udev_device *, const char *), device, name);
    ssize_t length = contents(device->number, ".uevent", device->text, sizeof device->text - 1);
    if (length < 0) return NULL;
    device->text[length] = 0;
    if (device->level == HID && !strcmp(name, "uevent")) return device->text;
    if (device->level == INTERFACE && !strcmp(name, "bInterfaceNumber")) return "00";
    if (device->level == USB && !strcmp(name, "bcdDevice")) return "0001";
    if (device->level == USB && !strcmp(name, "product")) {
        char *product = strstr(device->text, "HID_NAME=");
        if (!product) return NULL;
        product += strlen("HID_NAME=");
        product[strcspn(product, "\n")] = 0;
        return product;
    }
    return NULL;
}
