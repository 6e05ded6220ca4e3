/* SPDX-License-Identifier: MIT */
/* vertex_file.h owns the files that hold one value a vertex: CSV, NPY, PLY and GLB. It includes
 * nothing of ours, so that libprt and the client compile the same writers. All functions are
 * thread-safe: they touch only their arguments. */
#ifndef PRT_VERTEX_FILE_H
#define PRT_VERTEX_FILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

enum prt_vertex_format {
    PRT_VERTEX_NONE,
    PRT_VERTEX_CSV, /* "vertex,r,g,b", one row a vertex, %.9g */
    PRT_VERTEX_NPY, /* NumPy 1.0, little-endian float32 [n_vertex][3] */
    PRT_VERTEX_PLY, /* binary little-endian */
    PRT_VERTEX_GLB, /* glTF 2.0, unlit material, COLOR_0 as float */
};

/* Format that the ending of `path` names, in upper or lower case; PRT_VERTEX_NONE for any other
 * ending and for NULL. */
enum prt_vertex_format prt_vertex_format_of(const char *path);
/* Whether the format holds positions and triangles (PLY, GLB). */
bool prt_vertex_format_has_mesh(enum prt_vertex_format format);

/* Consecutive vertices and triangles of one object: a glTF primitive. */
struct prt_vertex_block {
    uint32_t object; /* consecutive blocks with one number share a node and a mesh in a GLB */
    uint32_t vertex_begin, n_vertex;
    uint32_t triangle_begin, n_triangle;
};

/* The contents of a file; every array is borrowed. CSV needs color. NPY writes color, else
 * position. PLY and GLB need position, and write normal and color where there are some. */
struct prt_vertex_data {
    uint32_t n_vertex, n_triangle;
    const float (*position)[3];           /* [n_vertex] */
    float unit;                           /* positions are divided by it when it is > 0 */
    const float (*normal)[3];             /* [n_vertex], unit vectors, or NULL */
    const float (*color)[3];              /* [n_vertex], linear RGB, or NULL */
    const uint32_t (*triangle)[3];        /* [n_triangle], below n_vertex */
    const struct prt_vertex_block *block; /* of a GLB; n_block 0: one block with everything */
    uint32_t n_block;
    const char *generator; /* name of the program, for a GLB */
};

enum { PRT_VERTEX_NO_MEMORY = -1, PRT_VERTEX_TOO_LARGE = -2 };
/* Writes the file's bytes to `out`; ferror(out) tells about the stream. Returns 0,
 * PRT_VERTEX_NO_MEMORY, or PRT_VERTEX_TOO_LARGE: a GLB of 4 GiB or more. Blocks of a GLB that
 * reach beyond the arrays are left out; those without triangles become points. */
int prt_vertex_file_write(FILE *out, enum prt_vertex_format format,
                          const struct prt_vertex_data *data);

/* An NPY file in memory: the rows of an array of shape (n, 3). */
struct prt_npy {
    uint64_t n;       /* rows; the file is exactly as long as they need */
    const void *rows; /* in the file's bytes, which it borrows */
    bool is_f64;      /* float64, else float32 */
};
/* Finds the rows of an NPY file of `size` bytes: C order, little-endian float32 or float64.
 * Returns NULL, or the reason why the bytes are no such file, which completes the sentence "the
 * file …"; then *out holds 0 rows. */
const char *prt_npy_parse(const void *bytes, size_t size, struct prt_npy *out);
/* Copies the rows to out[n][3], rounded to float32. */
void prt_npy_rows(const struct prt_npy *npy, float (*out)[3]);

#endif
