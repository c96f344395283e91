/* Preloaded into a program: every fsync and fdatasync takes SLOW_DISK_MS more, as an SD card's. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>

static void stall(void) {
    const char *text = getenv("SLOW_DISK_MS");
    long ms = text ? atol(text) : 0;
    struct timespec wait = {ms / 1000, ms % 1000 * 1000000};
    nanosleep(&wait, NULL);
}

static int (*real(const char *name))(int) {
    union {
        void *object;
        int (*function)(int);
    } found;
    found.object = dlsym(RTLD_NEXT, name);
    return found.function;
}

int fsync(int fd) {
    stall();
    return real("fsync")(fd);
}

int fdatasync(int fd) {
    stall();
    return real("fdatasync")(fd);
}
