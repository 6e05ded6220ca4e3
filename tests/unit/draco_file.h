/* SPDX-License-Identifier: MIT */
/* draco_file.h owns a writer of Draco streams for the tests, a C interface of libdraco. */
#ifndef UNIT_DRACO_FILE_H
#define UNIT_DRACO_FILE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* One attribute of a stream: n_value floats a vertex. Its id in the stream is its place in the
 * list. */
struct draco_attribute {
    enum { DRACO_POSITION, DRACO_NORMAL, DRACO_COLOR, DRACO_UV } kind;
    int n_value;
    const float *value; /* [n_vertex][n_value] */
};

/* Encodes a mesh without loss, vertices and triangles in their order. Returns the bytes written
 * to out, 0 on failure or where they are more than room. */
size_t draco_write(uint32_t n_vertex, uint32_t n_triangle, const uint32_t (*triangle)[3],
                   int n_attribute, const struct draco_attribute *attribute, void *out,
                   size_t room);

#ifdef __cplusplus
}
#endif
#endif
