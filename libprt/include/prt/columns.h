/* SPDX-License-Identifier: MIT
 * Factored rows of pairs or halves once more, by column: what a light's coefficient adds to all
 * rows lies together, the largest parts first. A contraction reads the parts that matter under
 * its light and leaves out the rest (METHODS §3.4). */
#ifndef PRT_COLUMNS_H
#define PRT_COLUMNS_H

#include "prt/transport.h"

enum {
    PRT_COLUMN_ROWS = 5,   /* rows of a chunk: 15 of 16 lanes, r g b of each */
    PRT_COLUMN_LANES = 16, /* lane 15 is 0 */
    PRT_COLUMN_LEVELS = 24,
};

/* Each plane of a row counts as a row here: row r's plane k of P is row P r + k.
 * What a column adds to one chunk is a unit: a word, 32 * chunk + a mask of its rows, and r g b
 * of each row in the mask. A unit's weight is the root of the sum of squares of its entries,
 * each times the length of its row's column of U. Level l holds weights up to
 * top * 2^(-l/2) of the group, the last one all weaker ones. */
struct prt_column_group {
    uint32_t chunk_begin, n_chunk; /* rows 5 chunk_begin to 5 (chunk_begin + n_chunk) */
    uint32_t n_unit, n_entry;
    float top;            /* largest weight */
    uint8_t *lowest;      /* [n_coef] level of the column's largest unit; LEVELS: it is empty */
    uint32_t *unit_begin; /* [n_coef] */
    uint32_t *entry_begin;                /* [n_coef] */
    uint16_t (*count)[PRT_COLUMN_LEVELS]; /* [n_coef] units of levels 0 to l */
    uint16_t *unit;                       /* [n_unit] by column, level, chunk */
    int16_t *entry;                       /* [n_entry][3], in units of scale; 64 bytes follow */
};

struct prt_columns {
    uint32_t n_group, n_chunk; /* chunks of all groups */
    uint32_t n_row, n_plane;   /* planes counted as rows; planes of a row */
    uint64_t n_unit;           /* of all groups */
    struct prt_column_group *group;
    /* Chunk by chunk [n_chunk][16]: the rows' scales (1 in place of 0), what each face's
     * scaling coefficient adds [n_chunk][6][16] in units of them, and the lengths of U's
     * columns. */
    float *scale, *scaling, *length;
    float gram[3][6][6]; /* squared length of U times what scaling coefficients x of a channel
                            add: x^T gram x */
    uint64_t bytes;
};

/* Whether the tensor has rows that columns can be made of: factored, diagonal, pairs or halves
 * with 16-bit indices. */
bool prt_columns_possible(const struct prt_tensor *tensor);
/* Makes the columns; groups are made in parallel. The caller destroys *out. Blocks;
 * thread-safe. PRT_ARG: they are not possible; PRT_NOMEM. */
int prt_columns_make(const struct prt_context *ctx, const struct prt_tensor *tensor,
                     struct prt_columns **out);
void prt_columns_destroy(struct prt_columns *columns); /* NULL: nothing */

#endif
