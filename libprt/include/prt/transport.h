/* SPDX-License-Identifier: MIT */
/* prt/transport.h owns the tensor T[vertex][j][omega] and its file, .prt. */
#ifndef PRT_TRANSPORT_H
#define PRT_TRANSPORT_H

#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_term { PRT_TERM_MULTIPLE = 0, PRT_TERM_SINGLE = 1 };
enum prt_storage { PRT_STORAGE_FACTORED = 0, PRT_STORAGE_SPARSE = 1, PRT_STORAGE_RADIAL = 2 };
enum prt_value { PRT_VALUE_I8 = 0, PRT_VALUE_F16 = 1, PRT_VALUE_PAIR = 2 };

/* How a value meets the light's RGB.
 * DIAGONAL: n_function = 3*n_phase, value [k][ch] multiplies light channel ch: out [k][ch].
 * FULL: n_function values, monochrome, each meets all three channels: out [j][ch]. */
enum prt_coupling { PRT_COUPLE_DIAGONAL = 0, PRT_COUPLE_FULL = 1 };

/* Sparse wavelet vectors ("rows"): a cluster's basis vectors, or W05's per-vertex transport.
 * Row i owns entries [begin[i], begin[i+1]). An entry is one Haar index and J values, J =
 * n_function; at most 2 n_coef a row. The six scaling coefficients of a row stand apart, dense,
 * in half precision: every row keeps them, and they would spoil the range of 8-bit values. */
struct prt_rows {
    uint32_t n_row;
    uint32_t n_function;  /* J */
    uint32_t n_coef;      /* 6*n*n of the cube */
    uint32_t value;       /* enum prt_value */
    uint32_t index_bytes; /* 2, or 4 when n_coef > 65536 */
    uint32_t reserved;
    const uint64_t *begin; /* [n_row+1] */
    const void *index;     /* [n_entry] u16/u32, never falling within a row (one twice: both
                              count, what the first entry's bytes left), never scaling */
    const void *entry;     /* [n_entry][J] i8 or f16 (IEEE half bits), unpadded; or mixed;
                              or i16 [n_entry/2][J][2] (pairs) */
    const float *scale;    /* [n_row][J], mixed [n_direction], multiplies integers; NULL: F16 */
    const uint16_t *scaling; /* [n_row][6][J] f16: coefficient 0 of each face */
    /* Mixed rows (FULL coupling, i8): what a row's entries hold spans few directions of
     * function space, at most PRT_ROWS_MOST_DIRECTIONS. Row i has D = direction[i+1] -
     * direction[i] of them and its entries are [entries of the row][D] bytes from
     * value_begin[i] on: function j of entry e = 2^-shift[e] sum_d entry[e][d]
     * scale[direction[i]+d] mix[..+d][j]. */
    const uint32_t *direction;   /* [n_row+1]; NULL: not mixed */
    const uint64_t *value_begin; /* [n_row+1] */
    const uint16_t *mix;         /* [n_direction][J] f16 */
    const uint8_t *shift;        /* [n_entry] 0 to 63 */
};
enum { PRT_ROWS_MOST_DIRECTIONS = 64 };

/* Rows of pairs (FACTORED, DIAGONAL, J = 3, 16-bit indices): two entries' integers lie side by
 * side, as instructions that sum two products want them. Every row has an even number of
 * entries, and the absolute sum of each 16 entries from its first on is at most PRT_PAIR_MOST
 * in every channel. channel c of entry e = entry[e/2][c][e%2] scale[row][c] prt_pair_gain(n,
 * index of e): a light times the gains has its levels of Haar alike in size under a sun, so
 * that it may be rounded. */
enum { PRT_PAIR_MOST = 65008, PRT_PAIR_BLOCK = 16 };
/* 2^(levels between the finest one and that of coefficient `index` of an n-cube, n a power of
 * two); 1 for scaling coefficients. */
float prt_pair_gain(uint32_t n, uint32_t index);
/* F16 rows (J = 3, 16-bit indices) as pairs in fresh arrays; PRT_NOMEM. Rounds to 3e-5 of a
 * row's largest entry. Free with prt_rows_finish. */
int prt_rows_pair(const struct prt_rows *rows, struct prt_rows *out);
void prt_rows_finish(struct prt_rows *rows); /* of DIAGONAL rows that own their arrays */

/* A cluster of vertices that share a basis. Never mixes objects or translucent with opaque. */
struct prt_cluster {
    uint32_t vertex_begin, n_vertex; /* in the tensor's own vertex order */
    uint32_t row_begin, rank;        /* rows [row_begin, +rank) are its basis */
    uint64_t u_begin;                /* first number of its U block in prt_tensor.u */
};

/* T[v][j][.] = sum_r U[v][r] rows[row_begin + r][j][.]            (FACTORED)
 * T[v][j][.] = rows[position of v]                                 (SPARSE)
 * colour[v][ch] = sum_j c[j][ch] U[v][j][ch], omega contracted     (RADIAL: polynomial)
 * U block of a cluster, padded = n_vertex rounded up to 16 with zeros behind:
 * FACTORED: i16 [(rank + 1) / 2][padded][2], two rows side by side as instructions that sum two
 * products want them, 0 beside an odd last row. U = integer * PRT_U_UNIT, at most PRT_U_MOST.
 * RADIAL: f16 [n_phase][n_radial][3][padded], rank = J; without a basis (n_knot 0) all c are 1:
 * colours that no material changes, a polynomial bake's opaque vertices.
 * Clusters tile the positions; one of rank 0 gives 0 to its vertices: a transport whose
 * material is free keeps its opaque vertices in a DIAGONAL tensor beside (tensors of a term add
 * up). */
struct prt_tensor {
    uint32_t term;         /* enum prt_term */
    uint32_t storage;      /* enum prt_storage */
    uint32_t coupling;     /* enum prt_coupling */
    uint32_t n_vertex;     /* all file vertices */
    uint32_t n_function;   /* J = n_radial * n_phase; DIAGONAL: 3 * n_phase, [k][ch];
                              FULL: [k][radial] */
    uint32_t n_phase;      /* 1, 4, 9, 16; 1 for multiple scattering */
    uint32_t n_cluster;    /* 0 for SPARSE */
    uint32_t n_radial;     /* radial basis functions; DIAGONAL: 0 */
    const uint32_t *order; /* [n_vertex] file vertex at each position of the tensor order */
    const struct prt_cluster *cluster;
    const uint16_t *u;    /* bits of i16, RADIAL of f16 */
    uint64_t u_count;     /* numbers in u */
    struct prt_rows rows; /* n_row 0 for RADIAL */
    /* Radial basis behind j (FULL, RADIAL): values on a grid; NULL otherwise. */
    uint32_t n_knot;     /* grid points */
    uint32_t basis_kind; /* enum of prt/radial.h */
    const float *knot;   /* [n_knot] mm */
    const float *basis;  /* [n_radial][n_knot] */
};

/* Rows of U span [-1/64, 1/64]: what is left for the rows of the basis lies well inside the
 * range of a half. */
enum { PRT_U_MOST = 1 << 14 };
#define PRT_U_UNIT 0x1p-20f

/* Everything a .prt holds. Arrays point into the map (prt_file_open) or into the baker's
 * memory (prt_file_write). */
struct prt_transport {
    struct prt_mesh mesh;         /* mm; mesh.owner NULL */
    struct prt_material material; /* of the bake; wavelet transport fixes it */
    uint32_t cube;                /* n of the wavelet cubemap */
    uint32_t engine;              /* enum prt_transport_kind */
    uint32_t n_tensor;
    struct prt_tensor tensor[4];
    const char *settings; /* JSON text: bake settings, provenance, versions, times */
    const char *errors;   /* JSON text: measured errors against the reference */
    uint64_t mesh_hash;   /* of the mesh content (positions, triangles, blocks) */
};
enum prt_transport_kind {
    PRT_TRANSPORT_WAVELET = 0,
    PRT_TRANSPORT_POLYNOMIAL = 1,
    PRT_TRANSPORT_JOINT = 2
};

enum { PRT_FILE_VERSION = 2 }; /* of the .prt format that this library reads and writes */

/* .prt: little-endian, versioned, 64-byte aligned sections each with an XXH3 checksum. */
int prt_file_write(const struct prt_context *ctx, const char *path,
                   const struct prt_transport *transport);

struct prt_file; /* a read-only map; its transport lives as long as it */
enum prt_file_check {
    PRT_FILE_CHECK_HEADERS, /* bounds and structure: every index a kernel follows is proven */
    PRT_FILE_CHECK_ALL,     /* and every section's checksum */
};
/* Refuses foreign, truncated, damaged files with a one-line message. */
int prt_file_open(const struct prt_context *ctx, const char *path, enum prt_file_check check,
                  struct prt_file **out);
/* The same over bytes in memory (fuzzing); bytes must outlive the file. */
int prt_file_open_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                         size_t n, enum prt_file_check check, struct prt_file **out);
const struct prt_transport *prt_file_transport(const struct prt_file *file);
uint64_t prt_file_bytes(const struct prt_file *file);
void prt_file_close(struct prt_file *file);
/* true when the file starts as a .prt does (cheap; for telling SOURCE kinds apart). */
bool prt_file_probe(const char *path);

/* IEEE half conversions; round to nearest even, overflow saturates to 65504. */
uint16_t prt_f32_to_f16(float x);
float prt_f16_to_f32(uint16_t h);
void prt_f32_to_f16_array(const float *x, size_t n, uint16_t *out);
void prt_f16_to_f32_array(const uint16_t *h, size_t n, float *out);

/* Bytes of a tensor: U, and rows (indices, values, offsets, scales) in all. */
void prt_tensor_bytes(const struct prt_tensor *tensor, uint64_t *u_bytes, uint64_t *row_bytes);

#ifdef __cplusplus
}
#endif
#endif
