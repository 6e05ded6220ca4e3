// SPDX-License-Identifier: MIT
// Made-up transports of any shape, for benchmarks and tests: random values, real structure.
#ifndef PRT_BENCH_SYNTHETIC_H
#define PRT_BENCH_SYNTHETIC_H

#include "prt/light.h"
#include "prt/transport.h"

struct synthetic_options {
    uint32_t storage, coupling, value; // enum prt_storage, prt_coupling, prt_value
    uint32_t term;
    uint32_t n_vertex, n_cluster; // clusters of about equal, never round, sizes
    uint32_t rank;                // FACTORED
    uint32_t n_phase, n_radial;
    uint32_t cube, coefs; // coefs: mean entries a row beside the scaling ones
    uint32_t run;         // mean run of file vertices in the tensor's order
    uint32_t patch; // > 0: vertices of a square grid by rows, clusters patches of this side
    uint64_t seed;
};

// Fills one tensor; every array is prt_alloc()ed. PRT_NOMEM at worst.
int synthetic_tensor(const struct synthetic_options *options, struct prt_tensor *out);
void synthetic_tensor_finish(struct prt_tensor *tensor);
// A grid-shaped mesh of n_vertex vertices around *transport, one translucent block and, when
// two_surfaces, a second opaque one over the last quarter of the vertices.
int synthetic_mesh(uint32_t n_vertex, bool two_surfaces, struct prt_mesh *out);
void synthetic_mesh_finish(struct prt_mesh *mesh);
int synthetic_light(uint32_t cube, uint64_t seed, struct prt_light *out);
// Writes a wavelet transport of the bunny's shape: 34,835 vertices (3,000 when quick), 64
// clusters of rank 40, 512 coefficients a row.
int synthetic_bunny(const struct prt_context *ctx, const char *path, bool quick, uint64_t seed);

#endif
