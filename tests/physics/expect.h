/* SPDX-License-Identifier: MIT */
/* expect.h owns assertions that show the measured value beside the bound it is held to. Each
 * expectation of a case has a name. Of all values under one name the case prints, when it ends,
 * the one that is nearest to its bound; a value beyond its bound fails the case at once. */
#ifndef PHYSICS_EXPECT_H
#define PHYSICS_EXPECT_H

#include "../data.h"

#include <math.h>

/* bound: of `value` (below, above), or of |value - want| (near). */
struct expectation {
    char name[64];
    enum { EXPECT_BELOW, EXPECT_ABOVE, EXPECT_NEAR } kind;
    double value, want, bound, used; /* used: 0 far from the bound, 1 at it */
    unsigned long count;
};

static struct expectation expect_list[64];
static unsigned expect_n;

static inline void expect_print(const struct expectation *e)
{
    char count[40] = "";
    if (e->count > 1) snprintf(count, sizeof count, " (worst of %lu)", e->count);
    if (e->kind == EXPECT_NEAR)
        print_message("  %s: %.6g, off by %.2g from %.6g, at most %.2g%s\n", e->name, e->value,
                      fabs(e->value - e->want), e->want, e->bound, count);
    else
        print_message("  %s: %.4g, must be %s %.4g%s\n", e->name, e->value,
                      e->kind == EXPECT_BELOW ? "below" : "above", e->bound, count);
}

/* Prints and forgets the values of the case that ends; a cmocka teardown function. */
static inline int expect_report(void **state)
{
    (void)state;
    for (unsigned i = 0; i < expect_n; i++) expect_print(&expect_list[i]);
    expect_n = 0;
    return 0;
}

static inline void expect_record(struct expectation now, const char *name, const char *file,
                                 int line)
{
    unsigned i = 0;
    while (i < expect_n && strcmp(expect_list[i].name, name)) i++;
    struct expectation *e = &expect_list[i];
    if (i == expect_n) {
        assert_true(expect_n < sizeof expect_list / sizeof *expect_list);
        assert_true(strlen(name) < sizeof e->name);
        expect_n++;
        memset(e, 0, sizeof *e);
        e->used = -INFINITY;
    }
    now.count = e->count + 1;
    memcpy(now.name, e->name, sizeof now.name);
    if (!now.name[0]) snprintf(now.name, sizeof now.name, "%s", name);
    if (now.used > e->used || isnan(now.used)) *e = now;
    else e->count++;
    if (!(now.used < 1)) {
        print_error("beyond its bound:\n");
        expect_report(NULL);
        _fail(file, line);
    }
}

static inline void expect_below_at(const char *name, double value, double bound,
                                   const char *file, int line)
{
    double used = value < bound ? bound > 0 ? value / bound : 0 : isnan(value) ? NAN : 1;
    expect_record(
        (struct expectation){
            .kind = EXPECT_BELOW, .value = value, .bound = bound, .used = used},
        name, file, line);
}

static inline void expect_above_at(const char *name, double value, double bound,
                                   const char *file, int line)
{
    double used = value > bound ? bound > 0 ? bound / value : -value : isnan(value) ? NAN : 1;
    expect_record(
        (struct expectation){
            .kind = EXPECT_ABOVE, .value = value, .bound = bound, .used = used},
        name, file, line);
}

static inline void expect_near_at(const char *name, double value, double want, double tolerance,
                                  const char *file, int line)
{
    double off = fabs(value - want), used = off / tolerance;
    if (off <= tolerance && !(used < 1)) used = 0.999999; /* at the bound, or exact with 0 */
    expect_record((struct expectation){.kind = EXPECT_NEAR,
                                       .value = value,
                                       .want = want,
                                       .bound = tolerance,
                                       .used = off <= tolerance ? used
                                               : isnan(off)     ? NAN
                                                                : fmax(used, 1)},
                  name, file, line);
}

/* The value must be below, above, or within `tolerance` of what is wanted. */
#define expect_below(name, value, bound) \
    expect_below_at(name, (double)(value), (double)(bound), __FILE__, __LINE__)
#define expect_above(name, value, bound) \
    expect_above_at(name, (double)(value), (double)(bound), __FILE__, __LINE__)
#define expect_near(name, value, want, tolerance)                                        \
    expect_near_at(name, (double)(value), (double)(want), (double)(tolerance), __FILE__, \
                   __LINE__)
/* Within a share of what is wanted. */
#define expect_close(name, value, want, relative) \
    expect_near(name, value, want, (relative)*fabs((double)(want)))

/* Chi-square of counts [n] against expectations: below its 99.9 % point (Wilson-Hilferty). */
__attribute__((unused)) static void expect_chi_square(const char *name, const double *want,
                                                      const uint32_t *got, int n)
{
    double x = 0, z = 3.09;
    int k = -1;
    for (int i = 0; i < n; i++) {
        if (want[i] < 5) continue;
        x += (got[i] - want[i]) * (got[i] - want[i]) / want[i];
        k++;
    }
    assert_true(k > 0);
    double a = 2.0 / (9.0 * k);
    expect_below(name, x, k * pow(1 - a + z * sqrt(a), 3));
}

/* A name with a part that varies; valid until the next call but three. */
__attribute__((format(printf, 1, 2), unused)) static const char *expect_name(const char *format,
                                                                             ...)
{
    static char text[4][64];
    static unsigned next;
    char *out = text[next++ % 4];
    va_list list;
    va_start(list, format);
    vsnprintf(out, sizeof text[0], format, list);
    va_end(list);
    return out;
}

static inline int expect_run(const char *group, const struct CMUnitTest *tests, size_t n,
                             CMFixtureFunction setup, CMFixtureFunction teardown)
{
    struct CMUnitTest *copy = calloc(n, sizeof *copy);
    if (!copy) return 1;
    memcpy(copy, tests, n * sizeof *copy);
    for (size_t i = 0; i < n; i++)
        if (!copy[i].teardown_func) copy[i].teardown_func = expect_report;
    int code = data_exit_code(_cmocka_run_group_tests(group, copy, n, setup, teardown), n);
    free(copy);
    return code;
}

/* run_test_group() that prints each case's values. */
#define run_physics_tests(tests, setup, teardown) \
    expect_run(#tests, tests, sizeof(tests) / sizeof((tests)[0]), setup, teardown)

#endif
