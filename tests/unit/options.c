// SPDX-License-Identifier: MIT
// The command line of prt: values at and beyond their limits, what excludes each other, and the
// one error line of a refusal.
#include "options.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static char said[1024]; // on standard error, by the last parse()

// Parses "prt LINE", whose words are separated by spaces; '_' stands for an empty word.
static int parse(const char *line, struct options *o)
{
    static char text[8192];
    char *argv[200] = {"prt"}, *rest = NULL;
    int argc = 1, old = dup(STDERR_FILENO);
    snprintf(text, sizeof text, "%s", line);
    for (char *w = strtok_r(text, " ", &rest); w && argc < 199; w = strtok_r(NULL, " ", &rest))
        argv[argc++] = strcmp(w, "_") ? w : "";
    FILE *f = tmpfile();
    assert_non_null(f);
    dup2(fileno(f), STDERR_FILENO);
    const int status = options_parse(argc, argv, o);
    fflush(stderr);
    dup2(old, STDERR_FILENO);
    close(old);
    rewind(f);
    said[fread(said, 1, sizeof said - 1, f)] = 0;
    fclose(f);
    return status;
}

static struct options accepted(const char *line)
{
    struct options o;
    if (parse(line, &o) != -1 || *said) fail_msg("refused '%s': %s", line, said);
    return o;
}

// A refusal is one line, which names the place of the help.
static void refused(const char *line, const char *why)
{
    struct options o;
    if (parse(line, &o) != EXIT_USAGE) fail_msg("accepted '%s'", line);
    const size_t n = strlen(said);
    if (strncmp(said, "error: ", 7) || !strstr(said, why) || strchr(said, '\n') != said + n - 1)
        fail_msg("'%s' is refused by '%s', not by '%s'", line, said, why);
    assert_int_equal(strcmp(said + n - 8, " --help\n"), 0);
}

static void numbers_at_their_limits(void **state)
{
    static const struct {
        const char *ok, *wrong;
    } row[] = {
        {"bake m --size-mm 1000000", "bake m --size-mm 1000001"},
        {"bake m --size-mm 1e-9", "bake m --size-mm 0"},
        {"bake m --size-mm +2.5E1", "bake m --size-mm 0x10"},
        {"bake m --texture-split 0", "bake m --texture-split -0.1"},
        {"bake m --texture-split 1", "bake m --texture-split 1.01"},
        {"bake m --threads 1", "bake m --threads 0"},
        {"bake m --threads 1024", "bake m --threads 1025"},
        {"bake m --threads 0007", "bake m --threads +7"},
        {"bake m --seed 18000000000000000000", "bake m --seed 18446744073709551616"},
        {"bake m --seed 0", "bake m --seed 1.0"},
        {"image m --budget-ms 0.5", "image m --budget-ms nan"},
        {"image m --budget-ms 1e7", "image m --budget-ms inf"},
        {"image m --exposure -40", "image m --exposure -40.5"},
        {"image m --quality 100", "image m --quality 101"},
        {"bake m --cube 16", "bake m --cube 8"},
        {"bake m --cube 128", "bake m --cube 256"},
        {"bake m --cube 32", "bake m --cube 48"},
        {"colors m --cube 48", "colors m --cube 3"},
        {"colors m --cube full", "bake m --cube full"},
        {"colors m --cube 2048", "colors m --cube 2049"},
        {"image m --size 1x4096", "image m --size 1x4097"},
        {"image m --size 4096x1", "image m --size 4097x1"},
        {"image m --size 1x1", "image m --size 0x1"},
        {"image m --size 10x20", "image m --size 1x0"},
        {"image m --size 20x10", "image m --size 20"},
        {"env m --size 16384", "env m --size 16385"},
        {"env m --size 1", "env m --size 0"},
        {"env m --size 64x32", "env m --size 64x"},
        {"bake m --shard 0/1", "bake m --shard 1/1"},
        {"bake m --shard 99999/100000", "bake m --shard 0/100001"},
        {"bake m --shard 2/3", "bake m --shard 3/3"},
        {"bake m --shard 1/2", "bake m --shard 0/0"},
        {"bake m --shard 0/2", "bake m --shard 1"},
        {"bake m --progress-fd 1048576", "bake m --progress-fd 1048577"},
        {"bake m --progress-fd 0", "bake m --progress-fd -1"},
        {"image m --eye 1,-2,3e0", "image m --eye 1,2"},
        {"image m --eye 1,2,3 4", "image m --eye 1,2 3"}, // of two words no vector is made
        {"image m --eye 1e30,0,0", "image m --eye 1.1e30,0,0"},
        {"image m --eye 0,0,0", "image m --eye 1,2,3,4"},
        {"image m --eye 0,0,.5", "image m --eye 1;2,3,4"},
        {"image m --eye -0,0,0", "image m --eye 1,2,"},
        {"image m --engine hybrid", "image m --engine wavelet"},
        {"colors m --engine wavelet", "colors m --engine hybrid"},
        {"bake m --storage sparse", "bake m --storage spars"},
        {"bake m --checkpoint c", "bake m --checkpoint _"},
        {"bake m --material skin1", "bake m --material _"},
        {"compare a b --env x", "compare a b --env _"},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        accepted(row[i].ok);
        refused(row[i].wrong, "expected ");
    }
    refused("bake m --shard 00000000000000000000000000000000000000000000000000001/3", "I/N");
}

static void values_are_stored(void **state)
{
    struct options o = accepted("bake m");
    assert_int_equal(o.command, CMD_BAKE);
    assert_int_equal(o.progress_fd, -1);
    assert_false(o.memory_set || o.eye.set || o.json);
    o = accepted("bake m -o out --shard 3/7 --memory 5 --cube 64 --storage sparse -q "
                 "--progress-fd 9 --texture-split 0.25");
    assert_string_equal(o.input[0], "m");
    assert_string_equal(o.out, "out");
    assert_string_equal(o.storage, "sparse");
    assert_true(o.shard == 3 && o.n_shard == 7 && o.memory == 5 && o.memory_set);
    assert_true(o.cube == 64 && !o.cube_full && o.quiet && o.progress_fd == 9);
    assert_true(o.texture_split == 0.25);
    o = accepted("image m map --eye 1,-2,3e1 --size 30x20");
    assert_int_equal(o.n_input, 2);
    assert_string_equal(o.input[1], "map");
    assert_true(o.eye.set && o.eye.v[0] == 1 && o.eye.v[1] == -2 && o.eye.v[2] == 30);
    assert_true(o.width == 30 && o.height == 20);
    o = accepted("env m --size 24");
    assert_true(o.width == 24 && o.height == 0);
    o = accepted("compare a b");
    assert_false(o.max_rmse_set || o.cube_full);
    o = accepted("compare a b -e x -e y --max-rmse 0 --cube full");
    assert_true(o.n_env == 2 && o.max_rmse_set && o.cube_full && !o.cube);
    assert_string_equal(o.env, "x"); // the first is the light without a table
    assert_string_equal(o.envs[1], "y");
    o = accepted("compare a b --cube full --cube 20"); // the last counts
    assert_true(o.cube == 20 && !o.cube_full);
    o = accepted("compare a b --cube 20 --cube full");
    assert_true(o.cube == 0 && o.cube_full);
    o = accepted("bake --json -- --json");
    assert_string_equal(o.input[0], "--json");
}

static void repeat(const char *line, const char *word, int n, const char *why)
{
    char text[8192];
    int at = snprintf(text, sizeof text, "%s", line);
    for (int i = 0; i < n; i++)
        at += snprintf(text + at, sizeof text - (size_t)at, " %s n%d", word, i);
    if (why) refused(text, why);
    else accepted(text);
}

static void lists_hold_so_many(void **state)
{
    repeat("bake m", "--opaque", MAX_OPAQUE, NULL);
    repeat("bake m", "--opaque", MAX_OPAQUE + 1, "at most 64");
    repeat("bake m", "--material", PRT_MEDIA_MAX, NULL);
    repeat("bake m", "--material", PRT_MEDIA_MAX + 1, "--material: at most ");
    repeat("compare a b", "--env", MAX_ENV, NULL);
    repeat("compare a b", "--env", MAX_ENV + 1, "at most 16");
}

static void what_does_not_go_together(void **state)
{
    static const struct {
        const char *ok, *wrong, *why;
    } row[] = {
        {"bake m", "bake", "expected MODEL"},
        {"compare a b", "compare a", "expected A B"},
        {"compare a b", "compare a b c", "c is one operand too many"},
        {"image m map", "image m map x", "x is one operand too many"},
        {"image m --msaa 4", "image m --msaa 6", "1, 2, 4 or 8"},
        {"image m --msaa 1", "image m --msaa 3", "1, 2, 4 or 8"},
        {"bake m --phase-terms 9", "bake m --phase-terms 16", "1, 4 or 9"},
        {"image m --phase-terms 16", "image m --phase-terms 15", "1, 4 or 9"},
        {"bake m --size-mm 3", "bake m --size-mm 3 --mm-per-unit 2", "choose one"},
        {"bake m --mm-per-unit 2", "bake m --mm-per-unit 2 --size-mm 3", "choose one"},
        {"info m --walks 16", "colors m --walks 16", "--scattering walk"},
        {"colors m --walks 16 --scattering walk", "colors m --walks 16 --scattering dipole",
         "--scattering walk"},
        {"image m --walks 16 --engine splat", "image m --walks 16 --engine reference",
         "--scattering walk"},
        {"image m --walks 16 --engine tangent", "image m --walks 16 --engine vertex",
         "--scattering walk"},
        {"image m --term unscattered --scattering walk", "image m --term unscattered",
         "the dipole has none"},
        {"colors m --term unscattered --scattering walk",
         "image m --term unscattered --scattering walk --engine splat", "the dipole has none"},
        {"image m --term difference", "colors m --term difference", "for prt image"},
        {"bake m --json", "bake m --json=1", "--json takes no value"},
        {"bake m --size-mm=3", "bake m --size-mm", "--size-mm needs D"},
        {"bake m -q", "bake m -qz", "-z is not an option here"},
        {"bake m -qo x", "bake m -qo", "--output needs FILE"},
        {"bake m --quiet", "bake m --quie", "--quie is not an option here"},
        {"bake m --quiet", "bake m --size 3", "--size is not an option here"},
        {"bake m --size-mm 3", "bake m --size-m 3", "--size-m is not an option here"},
        {"info m", "inf m", "inf is not a subcommand"},
        {"env m", "--env m", "--env is not an option of prt"},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        accepted(row[i].ok);
        refused(row[i].wrong, row[i].why);
    }
    refused("bake m --storage a\nb\x7f"
            "c",
            "--storage a b c: expected one of factored, sparse;");
}

static void a_weak_sandbox_is_accepted_on_demand(void **state)
{
    unsetenv(PRT_ACCEPT_WEAK_SANDBOX);
    accepted("info m");
    assert_null(getenv(PRT_ACCEPT_WEAK_SANDBOX));
    refused("info m --accept-weak-sandbox --json=1", "takes no value");
    assert_null(getenv(PRT_ACCEPT_WEAK_SANDBOX));
    accepted("info m --accept-weak-sandbox");
    assert_string_equal(getenv(PRT_ACCEPT_WEAK_SANDBOX), "1");
    unsetenv(PRT_ACCEPT_WEAK_SANDBOX);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_at_their_limits),
        cmocka_unit_test(values_are_stored),
        cmocka_unit_test(lists_hold_so_many),
        cmocka_unit_test(what_does_not_go_together),
        cmocka_unit_test(a_weak_sandbox_is_accepted_on_demand),
    };
    return cmocka_run_group_tests_name("options", tests, NULL, NULL);
}
