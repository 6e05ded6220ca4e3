// SPDX-License-Identifier: MIT
// What the service tests ask of the octahedron, and how answers are compared.
#ifndef RELIGHT_TESTS_ASK_H
#define RELIGHT_TESTS_ASK_H

#include "daemon.h"

#include <math.h>

enum { N_COLOR = 3 * OCTAHEDRON_VERTICES };

// A call that is to fail with this code, its text saying `word` (NULL: anything).
static inline void expect(int status, int code, const struct relight_error *error,
                          const char *word)
{
    if (status != -code || (word && !strstr(error->text, word)))
        fail_msg("status %d (%s) where %d with \"%s\" is expected", status, error->text, -code,
                 word ? word : "");
}

static inline void assert_close(const float *got, const float *want, size_t n, float tolerance)
{
    for (size_t k = 0; k < n; k++)
        if (!(fabsf(got[k] - want[k]) <= tolerance * fabsf(want[k]) + 1e-7f))
            fail_msg("colour %zu: %g, expected %g", k, (double)got[k], (double)want[k]);
}

// All planes of the answer, [n_plane][N_COLOR]; bound may be NULL.
static inline int ask_colors(struct relight_client *client,
                             const struct relight_colors_request *request, float *out,
                             float *bound, struct relight_error *error)
{
    struct relight_colors colors;
    int status = relight_colors(client, request, &colors, error);
    if (status) return status;
    assert_int_equal(colors.n_vertex, OCTAHEDRON_VERTICES);
    assert_int_equal(colors.n_plane, request->sum || !request->n_light ? 1 : request->n_light);
    for (uint32_t i = 0; i < colors.n_plane; i++)
        assert_int_equal(relight_colors_decode(&colors, i, out + i * N_COLOR), 0);
    if (bound) *bound = colors.cost.error_bound;
    relight_colors_finish(&colors);
    return 0;
}

// The CSV that prt and relight write.
static inline void read_csv(const char *path, float out[N_COLOR])
{
    char *text = read_text(path), *line = strchr(text, '\n');
    for (int v = 0; v < OCTAHEDRON_VERTICES; v++) {
        float *c = out + 3 * v;
        assert_non_null(line);
        assert_int_equal(sscanf(line + 1, "%*d,%f,%f,%f", c, c + 1, c + 2), 3);
        line = strchr(line + 1, '\n');
    }
    free(text);
}

// A 16-cube with a bright +X face and a gradient elsewhere, so that directions matter.
enum { CUBE_FLOATS = 6 * 16 * 16 * 3 };
static inline void fill_cube(float cube[CUBE_FLOATS])
{
    for (int i = 0; i < CUBE_FLOATS; i++)
        cube[i] = i < 16 * 16 * 3 ? 3 : 0.2f + (float)(i % 16) / 40;
}

#endif
