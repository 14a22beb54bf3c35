/* standalone.c: runs a harness over files, each in memory of its exact size, so that a read beyond it is seen. Exit 0:
 * all holds. */
#include "fuzz.h"

static void run(const char *path) {
    FILE *file = fopen(path, "rb");
    REQUIRE(file != NULL && fseek(file, 0, SEEK_END) == 0);
    const long size = ftell(file);
    REQUIRE(size >= 0 && fseek(file, 0, SEEK_SET) == 0);
    uint8_t *bytes = malloc((size_t)size + (size == 0));
    REQUIRE(bytes != NULL && fread(bytes, 1, (size_t)size, file) == (size_t)size);
    (void)fclose(file);
    fprintf(stderr, "%s\n", path); /* The last one before a fault is the one. */
    (void)LLVMFuzzerTestOneInput(bytes, (size_t)size);
    free(bytes);
}

int main(int count, char **paths) {
    for (int i = 1; i < count; i++) {
        run(paths[i]);
    }
    return 0;
}
