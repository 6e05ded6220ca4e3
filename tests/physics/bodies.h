/* SPDX-License-Identifier: MIT */
/* bodies.h owns the small bodies of the physics tests. A body is built in a struct model, whose
 * mesh image-space tests use as it is; body_mesh() makes a welded prt_mesh of one object from
 * it.
 */
#ifndef PHYSICS_BODIES_H
#define PHYSICS_BODIES_H

#include "prt/mesh.h"

#include <stdbool.h>

// One block an object, surfaces of 0.5.
struct model {
    struct prt_mesh mesh;
    struct prt_block block[4];
    struct prt_surface surface[4];
};
void model_init(struct model *m, uint32_t max_vertex, uint32_t max_triangle);
void model_finish(struct model *m);
struct prt_block *begin_block(struct model *m, bool translucent);
void end_block(struct model *m, struct prt_block *b);
// n x n squares spanned by u and v about a centre; the normal is u x v.
void add_sheet(struct model *m, const float c[3], const float u[3], const float v[3],
               uint32_t n);
// A closed box of half sizes h: one object.
void add_box(struct model *m, const float c[3], const float h[3], uint32_t n);
// A sphere of 2n x n squares whose seam has two columns of vertices, for uv: one object.
void add_sphere(struct model *m, const float c[3], float radius, uint32_t n);

// The radius [mm] of a ball at the polar angle theta from +y and the azimuth phi from +x.
typedef double (*body_radius)(double theta, double phi);
// A ball of n_u x n_v squares about the origin, vertex row * n_u + column, normals of a sphere;
// the first n_row rows have triangles: fewer than n_v leave a hole about -y.
void add_ball(struct model *m, uint32_t n_u, uint32_t n_v, uint32_t n_row, body_radius radius);
// The same, round and closed.
void add_round_ball(struct model *m, uint32_t n_u, uint32_t n_v, double radius_mm);
// A slab of size x thickness x size mm below y = 0 without side walls, n x n squares a face,
// flat normals. Vertices of the upper face come first, y * (n + 1) + x.
void add_slab(struct model *m, float size_mm, float thickness_mm, uint32_t n);
// A square of n x n squares from -half to half at height y, facing +y, vertex row * (n + 1) +
// column.
void add_floor(struct model *m, float half_mm, float y_mm, uint32_t n);

// A dented ball of about 16 mm: curvature of every sign, and shadow.
double dented_ball(double theta, double phi);
// A ball of 20 mm with six deep flutes: most of it sees itself.
double fluted_ball(double theta, double phi);

// One translucent object in mm, and the model is finished. With `normals` the model's own are
// kept, else they follow from the faces.
struct prt_mesh *body_mesh(const struct prt_context *ctx, struct model *m, bool normals);
// Makes an object of each run of vertices and triangles, which begin at 0 and ascend. rgb: of
// an opaque one; NULL: it is translucent. The mesh's blocks live until the next call.
enum { MOST_PARTS = 8 };
struct part {
    uint32_t vertex_begin, triangle_begin;
    const float *rgb;
};
void split_parts(struct prt_mesh *mesh, uint32_t n, const struct part part[]);
// Makes all from a vertex and a triangle on a second object, opaque, of that colour. As
// split_parts().
void split_opaque(struct prt_mesh *mesh, uint32_t vertex_begin, uint32_t triangle_begin,
                  const float rgb[3]);
// A round ball of 20 mm over an opaque square. As body_mesh().
struct prt_mesh *ball_over_square(const struct prt_context *ctx, uint32_t around,
                                  uint32_t along);

#endif
