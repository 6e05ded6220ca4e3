/* SPDX-License-Identifier: MIT */
/* prt/transport.h owns the tensor T[vertex][j][omega] (METHODS section 5) and its file, .prt.
 *
 * All functions are thread-safe. Those with a context return PRT_OK or a negative status and
 * log one line for an error; *out is set last, on success only. Lengths are in mm. */
#ifndef PRT_TRANSPORT_H
#define PRT_TRANSPORT_H

#include "prt/medium.h"
#include "prt/mesh.h"
#include "prt/variant.h"

#ifdef __cplusplus
extern "C" {
#endif

/* MULTIPLE by the dipole, or by walks (METHODS §9) of two scatterings or more; then UNSCATTERED
 * is there too, gathered like MULTIPLE. VIEW: what single scattering towards an eye has above
 * SINGLE corrected by prt_view_correct; answers without a view leave it out. */
enum prt_term {
    PRT_TERM_MULTIPLE = 0,
    PRT_TERM_SINGLE = 1,
    PRT_TERM_UNSCATTERED = 2,
    PRT_TERM_VIEW = 3,
};
/* Whether a term is 0 on opaque surfaces and has the extinction's radial basis. */
static inline bool prt_term_is_single(uint32_t term)
{
    return term == PRT_TERM_SINGLE || term == PRT_TERM_VIEW;
}
enum prt_storage { PRT_STORAGE_FACTORED = 0, PRT_STORAGE_SPARSE = 1, PRT_STORAGE_RADIAL = 2 };
enum prt_value { PRT_VALUE_I8 = 0, PRT_VALUE_F16 = 1, PRT_VALUE_PAIR = 2 };

/* Which channels of the light a value is multiplied with.
 * DIAGONAL: n_function = 3*n_phase; value [k][ch] with light channel ch, giving out [k][ch].
 * FULL: n_function monochrome values, each with all three channels, giving out [j][ch]. */
enum prt_coupling { PRT_COUPLE_DIAGONAL = 0, PRT_COUPLE_FULL = 1 };

/* Sparse wavelet vectors ("rows"): the basis vectors of a cluster, or W05's transport of a
 * vertex. Row i has entries [begin[i], begin[i+1]), at most 2 n_coef. An entry is one Haar
 * index and J values, J = n_function. The six scaling coefficients of a row are stored apart,
 * dense, as halves: every row has them, and they would exceed the range of 8-bit values. */
struct prt_rows {
    uint32_t n_row;
    uint32_t n_function;  /* J */
    uint32_t n_coef;      /* 6*n*n of the cube */
    uint32_t value;       /* enum prt_value */
    uint32_t index_bytes; /* 2, or 4 when n_coef > 65536 */
    uint32_t reserved;
    const uint64_t *begin; /* [n_row+1] */
    const void *index;     /* [n_entry] u16/u32, ascending within a row, none a scaling
                              coefficient. Two entries of one index add up: the second
                              holds what the first one's bytes could not */
    const void *entry;     /* [n_entry][J] i8 or f16 (IEEE half bits), unpadded; or low-rank
                              bytes; or i16 [n_entry/2][J][2] (pairs) */
    const float *scale; /* [n_row][J], low-rank [n_component]: factors of integers; NULL: F16 */
    const uint16_t *scaling; /* [n_row][6][J] f16: coefficient 0 of each face */
    /* Low-rank rows (FULL coupling, i8): all entries of a row are combinations of a few
     * components, vectors over the J functions, at most PRT_ROWS_MOST_DIRECTIONS. Row i has D =
     * direction[i+1] - direction[i] components, and its entries are [entries of the row][D]
     * bytes from value_begin[i] on: function j of entry e = 2^-shift[e] sum_d entry[e][d]
     * scale[direction[i]+d] mix[direction[i]+d][j]. */
    const uint32_t *direction;   /* [n_row+1]; NULL: the rows are not low-rank */
    const uint64_t *value_begin; /* [n_row+1] */
    const uint16_t *mix;         /* [n_component][J] f16 */
    const uint8_t *shift;        /* [n_entry] 0 to 63 */
};
enum { PRT_ROWS_MOST_DIRECTIONS = 64 };

/* Rows of pairs (FACTORED, DIAGONAL, J = 3, 16-bit indices): the integers of two entries lie
 * side by side, as instructions that add two products read them. Every row has an even number
 * of entries, and each block of 16 entries, counted from the row's first, has an absolute sum
 * of at most PRT_PAIR_MOST in every channel. Channel c of entry e = entry[e/2][c][e%2]
 * scale[row][c] prt_pair_gain(n, index of e). Lights are multiplied by the gains, which makes
 * all Haar levels of a sun similar in size, so that the product can be rounded to 16 bits. */
enum { PRT_PAIR_MOST = 65008, PRT_PAIR_BLOCK = 16 };
/* 2^k for a coefficient k levels above the finest one; 1 for scaling coefficients. n: the
 * cube's size, a power of two; index below 6 n n. */
float prt_pair_gain(uint32_t n, uint32_t index);
/* Rounds F16 rows (J = 3, 16-bit indices) to rows of pairs in arrays of their own, which the
 * caller frees with prt_rows_finish. The error is at most 3e-5 of a row's largest entry.
 * PRT_NOMEM: *out is empty. */
int prt_rows_pair(const struct prt_rows *rows, struct prt_rows *out);
/* Frees the arrays of DIAGONAL rows that own them and empties *rows. */
void prt_rows_finish(struct prt_rows *rows);

/* A cluster of vertices that share a basis: of one object, all translucent or all opaque. */
struct prt_cluster {
    uint32_t vertex_begin, n_vertex; /* in the tensor's vertex order */
    uint32_t row_begin, rank;        /* rows [row_begin, +rank) are its basis */
    uint64_t u_begin;                /* first number of its U block in prt_tensor.u */
};

/* One tensor. Tensors of the same term are summed.
 * T[v][j][.] = sum_r U[v][r] rows[row_begin + r][j][.]            (FACTORED)
 * T[v][j][.] = rows[position of v]                                 (SPARSE)
 * colour[v][ch] = sum_j c[j][ch] u_scale[j][ch] U[v][j][ch], omega contracted
 *                                                                  (RADIAL: polynomial)
 * U block of a cluster, padded = n_vertex rounded up to 16 with zeros behind:
 * FACTORED: i16 [(rank + 1) / 2][padded][2], two rows side by side as instructions that add two
 * products read them, 0 beside an odd last row. U = integer * PRT_U_UNIT, |integer| at most
 * PRT_U_MOST.
 * RADIAL: f16 [n_phase][n_radial][3][padded], rank = J, columns with factors of their own,
 * because their size is that of the light, of the medium's functions and of the model. Without
 * a basis (n_knot 0) all c are 1: colours that no material changes, such as a polynomial bake's
 * opaque vertices. Clusters partition the positions. A cluster of rank 0 gives 0 to its
 * vertices: a transport whose material is free keeps its opaque vertices in a second, DIAGONAL
 * tensor. */
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
    const float *u_scale; /* RADIAL: [n_cluster][J][3] factors of U's columns; NULL: 1 */
    struct prt_rows rows; /* n_row 0 for RADIAL */
    const struct prt_columns *columns; /* the rows by column, prt/columns.h; NULL: not made */
    /* Radial basis behind j (FULL, RADIAL): values on a grid; NULL otherwise. Of
     * PRT_RADIAL_WALK: the axes of a prt_walk_grid, levels and then nodes, and what each stored
     * function has of the answers of the grid's media. */
    uint32_t n_knot;     /* grid points */
    uint32_t basis_kind; /* enum of prt/radial.h */
    const float *knot;   /* [n_knot] mm; WALK: [n_level + n_node] mm^-1 */
    const float *basis;  /* [n_radial][n_knot]; WALK: [n_radial][n_level * n_node] */
    /* Any index (METHODS §5): the functions are those of the basis at each node of eta, node by
     * node, so that the basis has n_radial / nodes of them. Low, high and the nodes of
     * prt/eta_nodes.h; 0, NULL: each object has the index of its baked medium. */
    uint32_t n_eta; /* 2 + nodes */
    const float *eta;
};
/* Nodes of eta that the functions are for; 1: the index is fixed. */
static inline uint32_t prt_tensor_eta_nodes(const struct prt_tensor *tensor)
{
    return tensor->n_eta > 2 ? tensor->n_eta - 2 : 1;
}
/* Functions of the radial basis. */
static inline uint32_t prt_tensor_basis_size(const struct prt_tensor *tensor)
{
    return tensor->n_radial / prt_tensor_eta_nodes(tensor);
}
/* Numbers of basis for each function of the basis; 0: the axes are not those of a grid. */
uint32_t prt_tensor_basis_width(const struct prt_tensor *tensor);

/* U lies in [-1/64, 1/64]; the rows of the basis, which take the rest of the scale, then lie
 * well inside the range of a half. */
enum { PRT_U_MOST = 1 << 14 };
#define PRT_U_UNIT 0x1p-20f

/* Of a joint bake by walks: multiple scattering, opaque surfaces, unscattered light, single
 * scattering and its planes of exit. */
enum { PRT_MOST_TENSORS = 5 };

/* The content of a .prt. Arrays are borrowed: from the file (prt_file_open, prt_file_read) or
 * from the memory of whoever made them (prt_file_write). */
struct prt_transport {
    struct prt_mesh mesh;   /* mm; mesh.owner NULL */
    struct prt_media media; /* of the bake; those of a wavelet transport are fixed */
    uint32_t cube;          /* n of the wavelet cubemap */
    uint32_t engine;        /* enum prt_transport_kind */
    uint32_t n_tensor;
    struct prt_tensor tensor[PRT_MOST_TENSORS];
    const char *settings; /* JSON text: bake settings, provenance, versions, times */
    const char *errors;   /* JSON text: measured errors against the reference */
    uint64_t mesh_hash;   /* prt_mesh_hash() of the mesh that was baked; 0: not known */
};
enum prt_transport_kind {
    PRT_TRANSPORT_WAVELET = 0,
    PRT_TRANSPORT_POLYNOMIAL = 1,
    PRT_TRANSPORT_JOINT = 2
};

#ifndef PRT_FILE_VERSION       /* a test builds programs of the next version */
enum { PRT_FILE_VERSION = 2 }; /* of the .prt format that this library reads and writes */
#endif

/* Writes a .prt: little-endian, versioned, 64-byte aligned sections, each with an XXH3
 * checksum. The file appears whole or not at all (prt_writer). Blocks. PRT_FORMAT: the
 * transport would be refused when it is opened; PRT_IO; PRT_ARG: more than PRT_MOST_TENSORS. */
int prt_file_write(const struct prt_context *ctx, const char *path,
                   const struct prt_transport *transport);

struct prt_file; /* a map or a copy; its transport lives as long as the file is open */
enum prt_file_check {
    PRT_FILE_CHECK_HEADERS, /* bounds and structure: every index that is used unchecked later */
    PRT_FILE_CHECK_ALL,     /* the same, and the checksum of every section */
};
/* Maps and checks a file. Blocks; reads the whole file.
 * PRT_IO: it cannot be read; PRT_FORMAT: it is foreign, truncated, of another version or
 * damaged. The caller closes *out; the context is not kept. */
int prt_file_open(const struct prt_context *ctx, const char *path, enum prt_file_check check,
                  struct prt_file **out);
/* The same of a copy in memory, on huge pages where the system has them: relights of it miss
 * the TLB less, and nothing that happens to the file later harms it. PRT_IO, too: the
 * file became shorter meanwhile; PRT_NOMEM. */
int prt_file_read(const struct prt_context *ctx, const char *path, enum prt_file_check check,
                  struct prt_file **out);
/* The same for bytes in memory, which must outlive the file. name opens the error line. */
int prt_file_open_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                         size_t n, enum prt_file_check check, struct prt_file **out);
const struct prt_transport *prt_file_transport(const struct prt_file *file);
/* Makes the columns (prt/columns.h) of every tensor that can have them, with which contractions
 * of single lights take a fifth to two thirds of the time (METHODS §3.4). They belong to the
 * file. Blocks; other threads may relight with the file meanwhile, one may make columns.
 * PRT_NOMEM: the tensors keep those that were made. */
int prt_file_columns(const struct prt_context *ctx, struct prt_file *file);
/* Bytes of the file and of its columns. */
uint64_t prt_file_memory(const struct prt_file *file);
uint64_t prt_file_bytes(const struct prt_file *file);
/* A hash of the file's whole content: of its header and the checksums of its sections. */
uint64_t prt_file_hash(const struct prt_file *file);
void prt_file_close(struct prt_file *file); /* NULL: nothing */
/* Keeps pages of closed files, at most so many bytes in all, for those that
 * prt_file_read reads next: the system has to clear fresh ones. Frees those that are kept now.
 * 0, the default: none. A setting of the process. */
void prt_file_keep_pages(size_t most);
/* From now on a map (prt_file_open) whose pages cannot be read does not end the process: its
 * file became shorter, or its disk fails. Opening it returns PRT_IO; once it is open, such a
 * page reads as zeros. Handles SIGBUS; faults elsewhere are treated as before. A setting of the
 * process, made before threads open files; of the first 64 maps that are open at once. */
void prt_file_guard_maps(void);
/* Whether the file begins with a .prt's magic number; reads 8 bytes and logs nothing. */
bool prt_file_probe(const char *path);
/* The version in the file's header; 0: it is no .prt. */
uint32_t prt_file_version(const char *path);

/* Conversions between f32 and IEEE halves: round to nearest even, overflow saturates to 65504,
 * NaN stays NaN. The array forms give the same bits, in[n] to out[n]. */
uint16_t prt_f32_to_f16(float x);
float prt_f16_to_f32(uint16_t h);
void prt_f32_to_f16_array(const float *x, size_t n, uint16_t *out);
void prt_f16_to_f32_array(const uint16_t *h, size_t n, float *out);

/* Whether media of any index in a range are served; else those of the baked media's own.
 * range: the least and the greatest, written if so. */
bool prt_transport_any_eta(const struct prt_transport *transport, float range[2]);

/* What variants of the bake's model may change. */
enum prt_variant_of prt_transport_variants(const struct prt_transport *transport);

/* Bytes of a tensor's U, and of its rows with indices, offsets, scales and scaling
 * coefficients. */
void prt_tensor_bytes(const struct prt_tensor *tensor, uint64_t *u_bytes, uint64_t *row_bytes);

#ifdef __cplusplus
}
#endif
#endif
