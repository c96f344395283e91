/* A disk that hangs: statvfs does not return while the file $HANG_FILE exists. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/statvfs.h>
#include <unistd.h>

static void hang(void) {
    const char *path = getenv("HANG_FILE");
    while (path && access(path, F_OK) == 0) usleep(10000);
}

int statvfs(const char *path, struct statvfs *result) {
    int (*next)(const char *, struct statvfs *) = dlsym(RTLD_NEXT, "statvfs");
    hang();
    return next(path, result);
}

int statvfs64(const char *path, struct statvfs64 *result) {
    int (*next)(const char *, struct statvfs64 *) = dlsym(RTLD_NEXT, "statvfs64");
    hang();
    return next(path, result);
}
