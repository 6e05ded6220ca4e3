// SPDX-License-Identifier: MIT
// STL, binary and text: three vertices a facet in the file's order, smooth normals over welded
// positions, and faults that are named.
#include "prt/mesh.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "../data.h"

enum { RINGS = 12, SIDES = 24, MOST = 2 * RINGS * SIDES };
static const float radius = 7;

static char lines[8192];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(lines);
    snprintf(lines + n, sizeof lines - n, "%s\n", line);
}

static int load_named(const char *name, const void *bytes, size_t n, bool up_z,
                      struct prt_mesh **out)
{
    struct prt_context ctx;
    const struct prt_mesh_options options = {.up_z = up_z};
    prt_context_init(&ctx);
    ctx.log = keep_line;
    lines[0] = 0;
    *out = NULL;
    return prt_mesh_load_memory(&ctx, name, bytes, n, NULL, &options, out);
}

static int load(const void *bytes, size_t n, bool up_z, struct prt_mesh **out)
{
    return load_named("part.stl", bytes, n, up_z, out);
}

// Facets of a sphere about the origin, poles on z, outward.
static unsigned sphere(float facet[MOST][3][3])
{
    static float grid[RINGS + 1][SIDES][3];
    unsigned n = 0;
    for (int i = 0; i <= RINGS; i++)
        for (int j = 0; j < SIDES; j++) {
            double t = M_PI * i / RINGS, p = 2 * M_PI * j / SIDES;
            double s = i == 0 || i == RINGS ? 0 : sin(t);
            const double at[3] = {s * cos(p), s * sin(p), cos(t)};
            for (int k = 0; k < 3; k++) grid[i][j][k] = (float)(radius * at[k]) + 0.f;
        }
    for (int i = 0; i < RINGS; i++)
        for (int j = 0; j < SIDES; j++) {
            const float *a = grid[i][j], *b = grid[i + 1][j];
            const float *c = grid[i + 1][(j + 1) % SIDES], *d = grid[i][(j + 1) % SIDES];
            const float *const two[2][3] = {{a, b, c}, {a, c, d}};
            for (int f = i == RINGS - 1; f < (i == 0 ? 1 : 2); f++, n++)
                for (int k = 0; k < 3; k++) memcpy(facet[n][k], two[f][k], 12);
        }
    return n;
}

static size_t binary(unsigned n, float facet[][3][3], const char *head, char *out)
{
    uint32_t count = n;
    memset(out, ' ', 80);
    memcpy(out, head, strlen(head));
    memcpy(out + 80, &count, 4);
    for (unsigned i = 0; i < n; i++) {
        char *to = out + 84 + 50 * i;
        memset(to, 0, 50);
        memcpy(to + 12, facet[i], 36);
    }
    return 84 + (size_t)50 * n;
}

static size_t text(unsigned n, float facet[][3][3], char *out)
{
    char *p = out + sprintf(out, "solid a part\n");
    for (unsigned i = 0; i < n; i++) {
        p += sprintf(p, "facet normal 0 0 0\n outer loop\n");
        for (int k = 0; k < 3; k++)
            p += sprintf(p, "  vertex %.9g %.9g %.9g\n", (double)facet[i][k][0],
                         (double)facet[i][k][1], (double)facet[i][k][2]);
        p += sprintf(p, " endloop\nendfacet\n");
    }
    return (size_t)(p + sprintf(p, "endsolid a part\n") - out);
}

static float facets[MOST][3][3];
static char bytes[MOST * 200];

static void check_sphere(const struct prt_mesh *m, unsigned n, bool up_z)
{
    double worst = 1;
    assert_int_equal(m->n_vertex, 3 * n);
    assert_int_equal(m->n_triangle, n);
    assert_int_equal(m->n_boundary_edge, 0);
    assert_int_equal(m->n_weld, (RINGS - 1) * SIDES + 2);
    assert_int_equal(m->units_known, 0);
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        const float *from = facets[v / 3][v % 3], *at = m->position[v];
        assert_float_equal(at[0], from[0], 0);
        assert_float_equal(at[1], up_z ? from[2] : from[1], 0);
        assert_float_equal(at[2], up_z ? -from[1] : from[2], 0);
        double dot = 0;
        for (int k = 0; k < 3; k++) dot += (double)m->normal[v][k] * at[k] / radius;
        worst = fmin(worst, dot);
    }
    assert_true(worst > 0.995); // of a flat facet it would be cos(7.5 degrees) = 0.991 or less
}

static void both_forms_are_smooth_and_in_order(void **state)
{
    unsigned n = sphere(facets);
    struct prt_mesh *m;
    for (int form = 0; form < 4; form++) { // "solid" at the head of a binary file, too
        size_t size = form == 0   ? text(n, facets, bytes)
                      : form == 1 ? binary(n, facets, "solid by a program", bytes)
                                  : binary(n, facets, "made by a program", bytes);
        if (load(bytes, size, form == 3, &m)) fail_msg("form %d: %s", form, lines);
        check_sphere(m, n, form == 3);
        if (!form) assert_string_equal(m->surface[0].name, "a part");
        prt_mesh_destroy(m);
    }
}

// One facet is the least that a file holds, in either form and under either head; a byte less
// is no file. Its normal is the right hand's over the corners' order, whatever the facet says.
static void one_facet_is_a_model(void **state)
{
    static float one[1][3][3] = {{{1, 2, 3}, {4, 2, 3}, {1, 7, 3}}};
    static const char *const head[] = {"made by a program", "solid by a program"};
    struct prt_mesh *m;
    for (int form = 0; form < 3; form++) {
        size_t size = form < 2 ? binary(1, one, head[form], bytes) : text(1, one, bytes);
        if (load_named("part", bytes, size, false, &m)) fail_msg("form %d: %s", form, lines);
        assert_int_equal(m->n_vertex, 3);
        assert_int_equal(m->n_triangle, 1);
        assert_int_equal(m->n_boundary_edge, 3);
        assert_memory_equal(m->position, one, sizeof one);
        for (int i = 0; i < 3; i++) {
            assert_int_equal(m->triangle[0][i], i);
            for (int k = 0; k < 3; k++) assert_float_equal(m->normal[i][k], k == 2, 1e-6);
        }
        prt_mesh_destroy(m);
        if (form < 2) assert_int_equal(load(bytes, size - 1, false, &m), PRT_FORMAT);
    }
}

static void refuse_text(const char *what, const char *stl, const char *said)
{
    struct prt_mesh *m;
    assert_int_not_equal(load(stl, strlen(stl), false, &m), PRT_OK);
    if (!strstr(lines, said)) fail_msg("%s: said %s", what, lines);
}

static void faults_are_named(void **state)
{
    unsigned n = sphere(facets);
    struct prt_mesh *m;
    size_t size = binary(n, facets, "x", bytes);
    assert_int_equal(load(bytes, size - 7, false, &m), PRT_FORMAT);
    assert_non_null(strstr(lines, "and the file has"));
    assert_int_equal(load(bytes, size - 1, false, &m), PRT_FORMAT);
    memset(bytes + 80, 0xff, 4); // four billion facets
    assert_int_equal(load(bytes, size, false, &m), PRT_FORMAT);
    size = binary(n, facets, "x", bytes);
    const float nan[1] = {NAN};
    memcpy(bytes + 84 + 50 + 12, nan, 4);
    assert_int_equal(load(bytes, size, false, &m), PRT_FORMAT);
    assert_non_null(strstr(lines, "facet 1"));
    refuse_text("two", "solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendfacet\n", "line 5");
    refuse_text("four",
                "solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 1 0\n",
                "line 6");
    refuse_text("words", "solid a\nfacet\nvertex 0 zero 0\n", "line 3");
    refuse_text("end", "solid a\nfacet normal 0 0 1\nouter loop\n", "ends inside a facet");
    refuse_text("other", "solid a\nfacit\n", "line 2");
    refuse_text("far",
                "solid a\nfacet\nvertex 1e30 0 0\nvertex 1 0 0\nvertex 0 1 0\nendfacet\n",
                "beyond 1e15");
    refuse_text("none", "solid a\nendsolid a\n", "no triangles");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(both_forms_are_smooth_and_in_order),
        cmocka_unit_test(one_facet_is_a_model),
        cmocka_unit_test(faults_are_named),
    };
    return run_test_group(tests, NULL, NULL);
}
