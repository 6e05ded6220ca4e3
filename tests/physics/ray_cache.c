// SPDX-License-Identifier: MIT
// Rays that are kept for another bake of the same model change no byte of it; damaged, foreign
// and half-written files cost a warning and the rays; a folder keeps to its budget.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dirent.h>
#include <string.h>

#include "bake/row_store.h"
#include "bake_parts.h"
#include "bodies.h"

static char cache[64];
static unsigned warnings;

static void count_warnings(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_WARNING && strstr(line, ".rays")) warnings++;
}

// A fluted ball of 20 mm, whose flutes hide each other.
static struct prt_mesh *body(void)
{
    struct model m;
    model_init(&m, 40 * 21, 40 * 20 * 2);
    add_ball(&m, 40, 20, 20, fluted_ball);
    return body_mesh(&context, &m, false);
}

static struct prt_bake_options options(const char *material, enum prt_transport_kind engine)
{
    static struct prt_material medium;
    struct prt_bake_options o = {.engine = engine, .n_sample = 600, .seed = 3, .draft = true};
    assert_int_equal(prt_material_load(&context, material, &medium), PRT_OK);
    o.media = prt_media_one(&medium);
    return o;
}

// The one store of the folder; false: there is none.
static bool find_store(char path[512])
{
    DIR *dir = opendir(cache);
    bool found = false;
    for (struct dirent *e; dir && !found && (e = readdir(dir));)
        if (strstr(e->d_name, ".rays")) {
            snprintf(path, 512, "%s/%s", cache, e->d_name);
            found = true;
        }
    if (dir) closedir(dir);
    return found;
}

static off_t store_bytes(void)
{
    char path[512];
    struct stat st;
    return find_store(path) && !stat(path, &st) ? st.st_size : 0;
}

// Returns the bytes that the bake added to the folder's store: 0 when it cast no ray in pass 1.
static off_t bake(const struct prt_mesh *mesh, struct prt_bake_options o, const char *out)
{
    struct prt_context c = context;
    const off_t before = store_bytes();
    c.log = count_warnings;
    assert_int_equal(prt_bake(&c, mesh, &o, out), PRT_OK);
    return store_bytes() - before;
}

static void clear(void)
{
    char command[300];
    snprintf(command, sizeof command, "rm -rf %s", cache);
    assert_int_equal(system(command), 0);
}

// Contract of options.cache: with rays of another material, and of another eta where the
// material is free, a bake casts none in pass 1 and writes the bytes that it writes without.
static void second_material_casts_no_rays(void **state)
{
    struct prt_mesh *mesh = body();
    const enum prt_transport_kind engine[] = {PRT_TRANSPORT_WAVELET, PRT_TRANSPORT_JOINT};
    for (int i = 0; i < 2; i++) {
        clear();
        struct prt_bake_options first = options("marble", engine[i]);
        first.cache = cache;
        assert_true(bake(mesh, first, file("first.prt")) > 0);
        struct prt_bake_options second = options("skin1", engine[i]);
        bake(mesh, second, file("plain.prt"));
        second.cache = cache;
        warnings = 0;
        assert_int_equal(bake(mesh, second, file("second.prt")), 0);
        assert_int_equal(warnings, 0);
        same_bytes(file("plain.prt"), file("second.prt"));
    }
    prt_mesh_destroy(mesh);
}

// Contract of options.cache: a full bake after a draft writes the bytes that it writes without
// the draft's rays.
static void drafts_change_no_bytes(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("marble", PRT_TRANSPORT_WAVELET);
    clear();
    o.cube = 16;
    o.no_single = o.unmeasured = true;
    o.cache = cache;
    assert_true(bake(mesh, o, file("draft.prt")) > 0);
    o.draft = false;
    o.cache = NULL;
    bake(mesh, o, file("plain.prt"));
    o.cache = cache;
    bake(mesh, o, file("second.prt"));
    same_bytes(file("plain.prt"), file("second.prt"));
    prt_mesh_destroy(mesh);
}

// Contract of options.cache: whatever stands in the file, a bake writes its own bytes, with one
// warning where something was wrong, and leaves a file that the next one can use.
static void damage_costs_rays_alone(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("marble", PRT_TRANSPORT_WAVELET);
    char path[512];
    struct stat st;
    clear();
    bake(mesh, o, file("plain.prt"));
    o.cache = cache;
    bake(mesh, o, file("first.prt"));
    assert_true(find_store(path));
    assert_int_equal(stat(path, &st), 0);
    // In the header, in a record's description, in data; then cut in the header and in a
    // record.
    const off_t place[] = {3, 40, st.st_size - 1};
    for (unsigned i = 0; i < 3 + 2; i++) {
        if (i < 3) assert_true(invert_byte(path, place[i]));
        else assert_int_equal(truncate(path, i == 3 ? 5 : st.st_size / 2 + 1), 0);
        warnings = 0;
        bake(mesh, o, file("second.prt"));
        same_bytes(file("plain.prt"), file("second.prt"));
        assert_int_equal(warnings, 1);
        warnings = 0;
        assert_int_equal(bake(mesh, o, file("second.prt")), 0);
        assert_int_equal(warnings, 0);
    }
    prt_mesh_destroy(mesh);
}

// Contract of options.cache: a bake that is killed while it writes leaves whole records, and
// at most one that the next bake drops.
static void killed_bake_leaves_nothing_half(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("marble", PRT_TRANSPORT_WAVELET);
    char path[512];
    struct stat st;
    clear();
    bake(mesh, o, file("plain.prt"));
    o.cache = cache;
    pid_t child = bake_in_child(mesh, &o, file("killed.prt"));
    int how = 0;
    while (waitpid(child, &how, WNOHANG) == 0 &&
           !(find_store(path) && !stat(path, &st) && st.st_size > 4000))
        usleep(200);
    kill(child, SIGKILL);
    waitpid(child, &how, 0);
    warnings = 0;
    bake(mesh, o, file("second.prt"));
    same_bytes(file("plain.prt"), file("second.prt"));
    assert_true(warnings <= 1);
    assert_int_equal(bake(mesh, o, file("second.prt")), 0);
    prt_mesh_destroy(mesh);
}

// Contract of prt_ray_store_open: the least recently used files make room, and a full store
// takes no more.
static void folder_keeps_to_its_budget(void **state)
{
    enum { BYTES = 1000 };
    static char data[3 * BYTES];
    size_t bytes;
    uint64_t rays;
    clear();
    for (uint64_t key = 1; key <= 3; key++) {
        struct ray_store *s = prt_ray_store_open(&context, cache, "test", key, 3 * BYTES);
        assert_non_null(s);
        prt_ray_store_put(s, 7, 9, data, BYTES, key);
        prt_ray_store_put(s, 7, 9, data, 3 * BYTES, key); // does not fit
        prt_ray_store_close(s);
        char name[64];
        snprintf(name, sizeof name, "cache/test-%016llx.rays", (unsigned long long)key);
        const struct timespec used[2] = {{.tv_sec = (time_t)key}, {.tv_sec = (time_t)key}};
        assert_int_equal(utimensat(AT_FDCWD, file(name), used, 0), 0);
    }
    for (uint64_t key = 3; key >= 1; key--) {
        struct ray_store *s = prt_ray_store_open(&context, cache, "test", key, 3 * BYTES);
        char *got = prt_ray_store_get(s, 7, 9, &bytes, &rays);
        assert_true(!got == (key == 1)); // two files of 1100 bytes fit
        if (got) assert_true(bytes == BYTES && rays == key);
        prt_free(got);
        assert_null(prt_ray_store_get(s, 7, 8, &bytes, &rays));
        assert_null(prt_ray_store_get(s, 6, 9, &bytes, &rays));
        prt_ray_store_close(s);
    }
    assert_null(prt_ray_store_open(&context, "/proc/no/such", "test", 1, 1000));
}

// Contract of prt_lanes_pack: unpacked it is the same; of other bytes nothing is read beyond
// the end, and no row is longer than its packets.
static void rows_are_packed_whole(void **state)
{
    enum { N = 384 };
    uint16_t row[N], back[N + 8];
    uint8_t packed[3 * N];
    struct prt_rng rng;
    prt_rng_init(&rng, 7, 7);
    for (int round = 0; round < 500; round++) {
        uint32_t mixed = prt_rng_u32(&rng) % 5;
        for (int k = 0; k < N; k++) {
            bool again = k && prt_rng_u32(&rng) % 16;
            uint32_t kind = prt_rng_u32(&rng) % 5;
            row[k] = again          ? row[k - 1]
                     : kind < mixed ? (uint16_t)prt_rng_u32(&rng)
                     : kind % 2     ? 0xffff
                                    : 0;
        }
        size_t n = prt_lanes_pack(row, N, packed);
        assert_true(n <= prt_lanes_most(N));
        assert_int_equal(prt_lanes_unpack(packed, n, N, back), n);
        assert_memory_equal(row, back, sizeof row);
        assert_int_equal(prt_lanes_unpack(packed, n - 1, N, back), 0);
        uint8_t *exact = malloc(n); // a sanitizer sees reads beyond it
        assert_non_null(exact);
        for (size_t i = 0; i < n; i++) exact[i] = (uint8_t)prt_rng_u32(&rng);
        memset(back + N, 0x5a, 16);
        assert_true(prt_lanes_unpack(exact, n, N, back) <= n);
        for (int i = 0; i < 8; i++) assert_int_equal(back[N + i], 0x5a5a);
        free(exact);
    }
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    snprintf(cache, sizeof cache, "%s/cache", folder);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(second_material_casts_no_rays),
        cmocka_unit_test(drafts_change_no_bytes),
        cmocka_unit_test(damage_costs_rays_alone),
        cmocka_unit_test(killed_bake_leaves_nothing_half),
        cmocka_unit_test(folder_keeps_to_its_budget),
        cmocka_unit_test(rows_are_packed_whole),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
