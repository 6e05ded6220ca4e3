// SPDX-License-Identifier: MIT
// An answer while it is made: shared by answer.c, answer_media.c, answer_planes.c and
// answer_shade.c.
#ifndef PRT_RELIGHT_ANSWER_PARTS_H
#define PRT_RELIGHT_ANSWER_PARTS_H

#include "answer.h"

enum { VERTEX_GRAIN = 4096 }; // of a piece of a loop over vertices

struct answer {
    const struct prt_context *ctx;
    const struct prt_transport *transport;
    const struct prt_query *query;
    const struct prt_media *media;
    struct prt_light light; // coef NULL for polynomial
    size_t n_vertex;
    unsigned n_plane;
    unsigned n_phase; // planes that the tensors fill; the view's correction may need more
    bool view;        // single scattering is corrected for the view (view_correction.c)
    bool exits;       // and gets the planes of exit that the transport has
    bool apart;       // planes of multiple scattering, of single scattering, of exit
    unsigned n_exit;  // of the planes that are apart
    enum {
        ALL_TERMS,
        ONLY_SINGLE,
        ALL_BUT_SINGLE,
        ONLY_EXIT
    } part;        // of one step of a corrected answer, or of one whose terms are apart
    float *planes; // [n_plane][n_vertex][3]
    unsigned done; // bit i: tensor i has been added to the planes
    struct prt_coefficients *coefficients; // in place of planes; NULL: planes
};

// Whether the material of a tensor is free.
bool prt_tensor_is_free(const struct prt_tensor *tensor);
// Whether some medium scatters singly.
bool prt_media_scatter_singly(const struct prt_media *media);
// Media scatter evenly unless some g is not 0: their planes from 1 on are 0.
bool prt_media_scatter_evenly(const struct prt_media *media);

// Whether a tensor is part of a query's term.
bool prt_query_has_term(const struct prt_query *query, const struct prt_tensor *tensor);
// Whether a tensor is added to an answer in its step.
bool prt_answer_wants(const struct answer *a, const struct prt_tensor *tensor);

// Overwrites the planes, or the coefficients, of n answers of one transport, 1 to
// PRT_RELIGHT_MAX_LIGHTS. prt_answers_fill_as_one leaves out corrections for the view.
int prt_answers_fill(struct answer *a, unsigned n);
int prt_answers_fill_as_one(struct answer *a, unsigned n);

// out[i]: the colours of each of n answers that has no planes[i]; planes NULL: of all. `sink`,
// where it takes an answer, gets its colours in place of out[i]; NULL: none.
int prt_answers_shade(const struct answer *a, unsigned n, const bool planes[],
                      float *const out[], const struct prt_colors_sink *sink);

#endif
