/* SPDX-License-Identifier: MIT */
/* Real broken images: each is refused with an error line that names it, or loads to sane
 * pixels; none crashes this process, hangs, or takes more than its limit. */
#include "prt/light.h"

#include <ftw.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#include "../data.h"

static int n_file, n_refused, n_failed, n_error, n_warning, n_crash;
static char last_error[1100];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    n_warning += level == PRT_LOG_WARNING;
    if (level != PRT_LOG_ERROR) return;
    n_error++;
    snprintf(last_error, sizeof last_error, "%s", line);
}

__attribute__((noinline)) static void complain(const char *path, const char *what)
{
    print_error("%s: %s (%s)\n", path, what, last_error);
    n_failed++;
}

static bool must_load(const char *path)
{
    return strstr(path, "/oiio/seed.hdr") || strstr(path, "/oiio/bad.exr");
}

static bool must_fail(const char *path)
{
    static const char *const parts[] = {"hdr/derived/header_only",
                                        "hdr/derived/no_resolution",
                                        "hdr/derived/res_",
                                        "hdr/derived/rle_",
                                        "hdr/oiio/bomb",
                                        "dds/derived/",
                                        "exr/derived/datawindow_",
                                        "exr/derived/magic_only",
                                        "exr/derived/truncated_header",
                                        "exr/derived/compression_wrong",
                                        "exr/openexr_damaged/memory_DOS"};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
        if (strstr(path, parts[i])) return true;
    return false;
}

static int one_file(const char *path, const struct stat *st, int type, struct FTW *ftw)
{
    struct prt_context ctx;
    struct prt_image image;
    if (type != FTW_F) return 0;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    ctx.memory_limit = 1u << 30;
    n_error = n_warning = 0;
    last_error[0] = 0;
    const double begin = prt_time_s();
    const int status = prt_image_load(&ctx, path, &image);
    if (prt_time_s() - begin > 10) complain(path, "took more than 10 s");
    n_file++;
    if (status) {
        n_refused++;
        if (n_error < 1 || !strstr(last_error, path))
            complain(path, "no error line that names the file");
        if (must_load(path)) complain(path, "a valid file was refused");
        if (strstr(last_error, "crashed")) {
            n_crash++;
            print_message("in the child: %s\n", last_error);
            if (strstr(path, "/hdr/") || strstr(path, "cube_"))
                complain(path, "our own reader crashed");
        }
        return 0;
    }
    if (n_warning == 0 && (strstr(path, "compression_77") || strstr(path, "bad_magic")))
        complain(path, "a damaged file was accepted without a warning");
    if (must_fail(path)) complain(path, "a damaged file was accepted");
    if (!image.rgb || !image.width || !image.height) complain(path, "success without pixels");
    prt_image_finish(&image);
    struct prt_env *env = NULL; /* whatever loads as an environment has sane radiance */
    if (!prt_env_load(&ctx, path, &env)) {
        const size_t n = (size_t)env->latlong.width * env->latlong.height * 3;
        for (size_t i = 0; env->kind == PRT_ENV_LATLONG && i < n; i++)
            if (!(env->latlong.rgb[i] >= 0 && isfinite(env->latlong.rgb[i]))) {
                complain(path, "radiance is negative or not finite");
                break;
            }
        prt_env_destroy(env);
    }
    return 0;
}

static void every_broken_image(void **state)
{
    static const char *const folder[] = {PRT_SHARED_DATA "/broken/exr",
                                         PRT_SHARED_DATA "/broken/hdr",
                                         PRT_SHARED_DATA "/broken/dds"};
    want_data(folder[0]);
    setenv("PRT_LIBDIR", PRT_BINARY_DIR, 1);
    for (int i = 0; i < 3; i++) assert_int_equal(nftw(folder[i], one_file, 16, FTW_PHYS), 0);
    print_message("%d files, %d refused, %d of them by a crash of the child\n", n_file,
                  n_refused, n_crash);
    assert_true(n_file > 100);
    assert_int_equal(n_failed, 0);
}

/* A file cut at every length, and with each byte changed, without any development data. */
static void a_cut_or_changed_file(void **state)
{
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n";
    uint8_t file[256];
    size_t n = sizeof head - 1;
    memcpy(file, head, n);
    for (int y = 0; y < 2; y++) {
        memcpy(file + n, "\2\2\0\10\210\100\210\120\10abcdefgh\210\201", 19);
        n += 17 + 2;
    }
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    struct prt_env *env = NULL;
    for (size_t cut = 0; cut < n; cut += 3) {
        assert_int_not_equal(prt_env_load_memory(&ctx, "cut.hdr", file, cut, &env), 0);
        assert_null(env);
        assert_non_null(strstr(last_error, "cut.hdr"));
    }
    for (size_t i = 0; i < n; i += 2) {
        file[i] ^= 0xff;
        if (!prt_env_load_memory(&ctx, "changed.hdr", file, n, &env)) prt_env_destroy(env);
        assert_null(strstr(last_error, "crashed"));
        file[i] ^= 0xff;
    }
    assert_int_equal(prt_env_load(&ctx, "/nonexistent/a.hdr", &env), PRT_IO);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_broken_image),
                                       cmocka_unit_test(a_cut_or_changed_file)};
    return run_test_group(tests, NULL, NULL);
}
