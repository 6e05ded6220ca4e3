// SPDX-License-Identifier: MIT
// Morph targets and skins of a glTF in a pose.
#include "gltf_pose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_SETS = 4 }; // JOINTS_0 to JOINTS_3: 16 joints a vertex

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

// ---- morph targets

// The weight of target i: the animation's, the node's, the mesh's, 0.
static double target_weight(const struct gltf *g, size_t node, const cJSON *mesh, int i)
{
    const struct gltf_moment *m = &g->pose->node[node];
    const cJSON *list = member(g->pose->json_node[node], "weights");
    if (m->n_weight) return (size_t)i < m->n_weight ? (double)m->weight[i] : 0;
    if (!list) list = member(mesh, "weights");
    const cJSON *v = cJSON_GetArrayItem(list, i);
    return cJSON_IsNumber(v) && fabs(v->valuedouble) < 1e6 ? v->valuedouble : 0;
}

// Adds weight times the accessor's vectors.
static int add_vectors(struct gltf *g, int64_t accessor, double weight, uint32_t n,
                       float (*out)[3])
{
    struct gltf_accessor a;
    float *delta = NULL;
    int status = prt_gltf_read_floats(g, accessor, 3, &a, &delta);
    if (!status && a.count != n) {
        status = prt_gltf_bad(g, "accessor %zu: has %llu elements for %u vertices", a.index,
                              (unsigned long long)a.count, n);
    } else if (!status) {
        for (uint32_t v = 0; v < n; v++)
            for (int c = 0; c < 3; c++)
                out[v][c] = (float)((double)out[v][c] + weight * (double)delta[3 * v + c]);
    }
    free(delta);
    return status;
}

static int morph(struct gltf *g, size_t node, const cJSON *mesh, const cJSON *primitive,
                 uint32_t first, uint32_t n)
{
    const cJSON *target;
    int i = 0, status = PRT_OK;
    cJSON_ArrayForEach(target, member(primitive, "targets"))
    {
        const double weight = target_weight(g, node, mesh, i++);
        if (weight == 0) continue;
        if (member(target, "POSITION"))
            status = add_vectors(g, prt_gltf_whole(target, "POSITION"), weight, n,
                                 g->d->position + first);
        if (!status && member(target, "NORMAL"))
            status = add_vectors(g, prt_gltf_whole(target, "NORMAL"), weight, n,
                                 g->d->normal + first);
        if (status) return status;
    }
    return PRT_OK;
}

// ---- skins

// Matrices from the mesh to the world, one for each joint, column-major.
struct joints {
    double (*m)[16];
    size_t n;
};

static void multiply(const double *a, const float *b, double *out)
{
    for (int c = 0; c < 4; c++)
        for (int r = 0; r < 4; r++) {
            out[c * 4 + r] = 0;
            for (int k = 0; k < 4; k++) out[c * 4 + r] += a[k * 4 + r] * (double)b[c * 4 + k];
        }
}

// The inverse bind matrices, identity where the skin has none; free() them.
static int read_inverse(struct gltf *g, const cJSON *skin, size_t n, float **out)
{
    static const float identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    struct gltf_accessor a;
    if (member(skin, "inverseBindMatrices")) {
        int status =
            prt_gltf_read_floats(g, prt_gltf_whole(skin, "inverseBindMatrices"), 16, &a, out);
        if (!status && a.count < n)
            status = prt_gltf_bad(g, "accessor %zu: %llu inverse bind matrices for %zu joints",
                                  a.index, (unsigned long long)a.count, n);
        return status;
    }
    *out = malloc(n * sizeof identity);
    if (!*out) return prt_gltf_no_memory(g);
    for (size_t i = 0; i < n; i++) memcpy(*out + 16 * i, identity, sizeof identity);
    return PRT_OK;
}

static int fill_joints(struct gltf *g, const cJSON *skin, const float *inverse,
                       struct joints *j)
{
    const cJSON *one;
    size_t i = 0;
    cJSON_ArrayForEach(one, member(skin, "joints"))
    {
        const double x = cJSON_IsNumber(one) ? one->valuedouble : -1;
        if (!(x >= 0 && x < (double)g->file.n_node))
            return prt_gltf_bad(g, "joint %zu of a skin is no node of the file", i);
        if (!g->pose->has_world[(size_t)x])
            return prt_gltf_bad(g, "joint %zu of a skin, node %zu, is not in the scene", i,
                                (size_t)x);
        multiply(g->pose->world[(size_t)x], inverse + 16 * i, j->m[i]);
        i++;
    }
    return PRT_OK;
}

static int make_joints(struct gltf *g, int64_t index, struct joints *j)
{
    if (index < 0 || (uint64_t)index >= g->pose->n_skin)
        return prt_gltf_bad(g, "skin %lld does not exist", (long long)index);
    const cJSON *skin = g->pose->skin[index];
    float *inverse = NULL;
    j->n = (size_t)cJSON_GetArraySize(member(skin, "joints"));
    if (!j->n) return prt_gltf_bad(g, "skin %lld has no joints", (long long)index);
    int status = prt_gltf_pose_work(g, 64 * (uint64_t)j->n);
    if (status) return status;
    j->m = calloc(j->n, sizeof *j->m);
    status = j->m ? read_inverse(g, skin, j->n, &inverse) : prt_gltf_no_memory(g);
    if (!status) status = fill_joints(g, skin, inverse, j);
    free(inverse);
    return status;
}

// One set of four joints and weights a vertex.
struct influence {
    float *joint, *weight;
};

static int read_influence(struct gltf *g, const cJSON *attributes, unsigned set, uint32_t n,
                          struct influence *out)
{
    char joints[] = "JOINTS_0", weights[] = "WEIGHTS_0";
    struct gltf_accessor a, b;
    joints[7] = weights[8] = (char)('0' + set);
    int status =
        prt_gltf_read_floats(g, prt_gltf_whole(attributes, joints), 4, &a, &out->joint);
    if (!status)
        status =
            prt_gltf_read_floats(g, prt_gltf_whole(attributes, weights), 4, &b, &out->weight);
    if (status) return status;
    if (a.count != n || b.count != n)
        return prt_gltf_bad(g, "%s and %s do not have one element for each of %u vertices",
                            joints, weights, n);
    if ((a.component != 5121 && a.component != 5123) || a.normalized)
        return prt_gltf_bad(
            g, "accessor %zu: joints must be unsigned whole numbers of 8 or 16 bits", a.index);
    return PRT_OK;
}

// The weighted mean of a vertex's joints; weights are normalised.
static int blend(const struct gltf *g, const struct joints *j, const struct influence *in,
                 unsigned n_set, uint32_t v, double out[16])
{
    double sum = 0;
    memset(out, 0, 16 * sizeof *out);
    for (unsigned k = 0; k < 4 * n_set; k++) {
        const float w = in[k / 4].weight[4 * (size_t)v + k % 4];
        const float joint = in[k / 4].joint[4 * (size_t)v + k % 4];
        if (!(w >= 0 && w < 1e6f))
            return prt_gltf_bad(g, "mesh %zu: a weight of vertex %u is %g", g->mesh_index, v,
                                (double)w);
        if (!((double)joint < (double)j->n))
            return prt_gltf_bad(g, "mesh %zu: vertex %u names joint %g of %zu", g->mesh_index,
                                v, (double)joint, j->n);
        sum += (double)w;
        for (int i = 0; i < 16 && w > 0; i++) out[i] += (double)w * j->m[(size_t)joint][i];
    }
    if (!(sum > 0)) { // a vertex without weights follows its first joint
        memcpy(out, j->m[(size_t)in[0].joint[4 * (size_t)v]], 16 * sizeof *out);
        return PRT_OK;
    }
    for (int i = 0; i < 16; i++) out[i] /= sum;
    return PRT_OK;
}

// Position and normal by m; the normal by its cofactors, so that it stays perpendicular.
// Returns the determinant.
static double move(const double m[16], float p[3], float q[3])
{
    double x[3], y[3], cof[9];
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++) {
            const int r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
            cof[c * 3 + r] = m[c1 * 4 + r1] * m[c2 * 4 + r2] - m[c1 * 4 + r2] * m[c2 * 4 + r1];
        }
    const double det = m[0] * cof[0] + m[1] * cof[1] + m[2] * cof[2];
    for (int r = 0; r < 3; r++) {
        x[r] =
            m[r] * (double)p[0] + m[4 + r] * (double)p[1] + m[8 + r] * (double)p[2] + m[12 + r];
        y[r] = cof[r] * (double)q[0] + cof[3 + r] * (double)q[1] + cof[6 + r] * (double)q[2];
    }
    const double length = sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    const double scale = length > 1e-12 ? (det < 0 ? -1 : 1) / length : 0;
    for (int r = 0; r < 3; r++) {
        p[r] = (float)x[r];
        q[r] = (float)(y[r] * scale);
    }
    return det;
}

static int bend(struct gltf *g, const struct joints *j, const struct influence *in,
                unsigned n_set, uint32_t first, uint32_t n, double *det)
{
    for (uint32_t v = 0; v < n; v++) {
        double m[16];
        int status = blend(g, j, in, n_set, v, m);
        if (status) return status;
        const double own = move(m, g->d->position[first + v], g->d->normal[first + v]);
        if (!v) *det = own;
    }
    return PRT_OK;
}

static int skin_vertices(struct gltf *g, int64_t skin, const cJSON *attributes, uint32_t first,
                         uint32_t n, double *det)
{
    struct joints j = {0};
    struct influence in[MOST_SETS] = {{0}};
    unsigned n_set = 0;
    int status = make_joints(g, skin, &j);
    for (char name[] = "JOINTS_0"; !status && n_set < MOST_SETS && member(attributes, name);
         name[7]++, n_set++)
        status = read_influence(g, attributes, n_set, n, &in[n_set]);
    if (!status) status = prt_gltf_pose_work(g, 64ull * n_set * n);
    if (!status) status = bend(g, &j, in, n_set, first, n, det);
    for (unsigned k = 0; k < MOST_SETS; k++) {
        free(in[k].joint);
        free(in[k].weight);
    }
    free(j.m);
    return status;
}

int prt_gltf_deform(struct gltf *g, size_t node, size_t primitive, uint32_t first, uint32_t n,
                    bool *skinned, double *det)
{
    const struct prt_gltf_node *file_node = &g->file.node[node];
    const cJSON *mesh = g->pose->mesh[file_node->mesh];
    const cJSON *one = cJSON_GetArrayItem(member(mesh, "primitives"), (int)primitive);
    const cJSON *attributes = member(one, "attributes");
    int status = morph(g, node, mesh, one, first, n);
    *skinned = false;
    if (status || file_node->skin < 0 || !member(attributes, "JOINTS_0")) return status;
    if (g->file.mesh[file_node->mesh].primitive[primitive].draco) {
        g->n_deformed++; // the decoder keeps no joints
        return PRT_OK;
    }
    *skinned = true;
    return skin_vertices(g, file_node->skin, attributes, first, n, det);
}
