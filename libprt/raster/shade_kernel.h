/* SPDX-License-Identifier: MIT */
/* Shading of up to LANES points or pixels: plain loops that the compiler vectorises. Included
 * by shade.c once for each instruction set, in its region of base/isa.h. */

/* Bilinear look-up of n directions: the offset of the first of four texels, and fractions. */
static void PRT_KERNEL(cube_lookup)(const struct cube_view *cube, int n,
                                    const float *restrict dx, const float *restrict dy,
                                    const float *restrict dz, struct lookup *restrict at)
{
    const float half = 0.5f * (float)cube->n, centre = half - 0.5f + (float)cube->border;
    const int row = cube->row, hi = cube->last;
    const int texel_floats = cube->texel_floats, face_floats = cube->face;
    for (int i = 0; i < n; i++) {
        float x = dx[i], y = dy[i], z = dz[i];
        float ax = fabsf(x), ay = fabsf(y), az = fabsf(z);
        /* 1 for the axis of the face, 0 for the others: products instead of branches, which
         * keep the compiler from vectorising the loop */
        int is_x = (ax >= ay) & (ax >= az), is_y = (1 - is_x) & (ay >= az);
        float on_x = (float)is_x, on_y = (float)is_y, on_z = 1.0f - on_x - on_y;
        float major = on_x * x + on_y * y + on_z * z, ma = fabsf(major);
        int negative = major < 0;
        float sign = 1.0f - 2.0f * (float)negative;
        float s = on_y * x + sign * (on_z * x - on_x * z);
        float t = on_y * (sign * z) - (1.0f - on_y) * y;
        float k = half / (ma > 1e-30f ? ma : 1e-30f);
        int face = 4 - 4 * is_x - 2 * is_y + negative;
        float px = s * k + centre, py = t * k + centre;
        px = px > 0 ? px : 0;
        py = py > 0 ? py : 0;
        int x0 = (int)px, y0 = (int)py;
        x0 = x0 > hi ? hi : x0;
        y0 = y0 > hi ? hi : y0;
        /* behind the last pair of texels the second of them */
        float fx = px - (float)x0, fy = py - (float)y0;
        at->fx[i] = fx < 1 ? fx : 1;
        at->fy[i] = fy < 1 ? fy : 1;
        at->first[i] = face * face_floats + y0 * row + x0 * texel_floats;
    }
}

/* Three floats at `at`, with a fourth that is not used; `last`: the greatest offset at which
 * four floats can be read. */
static inline __attribute__((always_inline)) four PRT_KERNEL(load3)(const float *from,
                                                                    size_t at, size_t last)
{
    const float *p = from + at;
    if (at <= last) return *(const loose_four *)p;
    return (four){p[0], p[1], p[2], 0};
}

static inline __attribute__((always_inline)) four PRT_KERNEL(load4)(const float *p)
{
    return *(const loose_four *)p;
}

static inline __attribute__((always_inline)) void PRT_KERNEL(store3)(float *to, four value)
{
    to[0] = value[0];
    to[1] = value[1];
    to[2] = value[2];
}

/* a + t (b - a), in one rounding where the instruction set has that. */
static inline __attribute__((always_inline)) four PRT_KERNEL(mix4)(four a, four b, float t)
{
#if PRT_ISA_LANES > 4
    return (four)_mm_fmadd_ps(_mm_set1_ps(t), (__m128)(b - a), (__m128)a);
#else
    return a + t * (b - a);
#endif
}

/* The same in place, of eight: a value of eight is no parameter where registers hold four. */
static inline __attribute__((always_inline)) void PRT_KERNEL(mix8)(eight *a, const eight *b,
                                                                   float t)
{
#if PRT_ISA_LANES > 4
    *a = (eight)_mm256_fmadd_ps(_mm256_set1_ps(t), (__m256)(*b - *a), (__m256)*a);
#else
    *a += t * (*b - *a);
#endif
}

/* Two texels of four floats side by side, between their row and the next. */
static inline __attribute__((always_inline)) void
PRT_KERNEL(column8)(const float *texel, int row, float fy, eight *out)
{
    const eight below = *(const loose_eight *)(texel + row);
    *out = *(const loose_eight *)texel;
    PRT_KERNEL(mix8)(out, &below, fy);
}

/* Between the two. */
static inline __attribute__((always_inline)) four PRT_KERNEL(across)(const eight *pair,
                                                                     float fx)
{
    return PRT_KERNEL(mix4)(__builtin_shufflevector(*pair, *pair, 0, 1, 2, 3),
                            __builtin_shufflevector(*pair, *pair, 4, 5, 6, 7), fx);
}

/* Bilinear mean of texels of three floats. Of a load that begins behind `last` only three. */
static inline __attribute__((always_inline)) four
PRT_KERNEL(fetch3)(const float *texel, size_t at, size_t row, float fx, float fy, size_t last)
{
    four left = PRT_KERNEL(mix4)(PRT_KERNEL(load3)(texel, at, last),
                                 PRT_KERNEL(load3)(texel, at + row, last), fy);
    four right = PRT_KERNEL(mix4)(PRT_KERNEL(load3)(texel, at + 3, last),
                                  PRT_KERNEL(load3)(texel, at + row + 3, last), fy);
    return PRT_KERNEL(mix4)(left, right, fx);
}

static void PRT_KERNEL(cube_fetch)(const struct cube_view *cube, int n,
                                   const struct lookup *restrict at, four *restrict rgb)
{
    const float *texel = cube->texel;
    const int row = cube->row, last = 6 * cube->face - 4;
    int most = 0;
    for (int i = 0; i < n; i++) most = at->first[i] > most ? at->first[i] : most;
    if (cube->texel_floats == 4) {
        for (int i = 0; i < n; i++) {
            eight pair;
            PRT_KERNEL(column8)(texel + at->first[i], row, at->fy[i], &pair);
            rgb[i] = PRT_KERNEL(across)(&pair, at->fx[i]);
        }
        return;
    }
    const bool whole = most + row + 3 <= last; /* all loads may be of four */
    for (int i = 0; whole && i < n; i++)
        rgb[i] = PRT_KERNEL(fetch3)(texel, (size_t)at->first[i], (size_t)row, at->fx[i],
                                    at->fy[i], SIZE_MAX);
    for (int i = 0; !whole && i < n; i++)
        rgb[i] = PRT_KERNEL(fetch3)(texel, (size_t)at->first[i], (size_t)row, at->fx[i],
                                    at->fy[i], (size_t)last);
}

/* A value of the blocks that n points lie in. */
static void PRT_KERNEL(gather)(const struct shade_job *job, const float *of_block, size_t at,
                               int n, float *restrict out)
{
    const uint32_t *block = job->g->block + at;
    for (int i = 0; job->one_medium && i < n; i++) out[i] = of_block[0];
    for (int i = 0; !job->one_medium && i < n; i++) out[i] = of_block[block[i]];
}

/* The normal that shading takes where the eye sees it: see struct eyed_normal. */
static inline __attribute__((always_inline)) struct eyed_normal
PRT_KERNEL(eyed_normal)(float wx, float wy, float wz, float nx, float ny, float nz,
                        float facing, float eta)
{
    float l = 1.0f / sqrtf(wx * wx + wy * wy + wz * wz + 1e-30f);
    wx *= l;
    wy *= l;
    wz *= l;
    float c = wx * nx + wy * ny + wz * nz, least = 0.5f * facing;
    c = c < 1 ? c : 1;
    least = least > 1e-3f ? least : 1e-3f;
    float cc = c > least ? c : least;
    float keep = sqrtf((1 - cc * cc) / (1 - c * c + 1e-12f)), add = cc - keep * c;
    keep = c > least ? 1 : keep;
    add = c > least ? 0 : add;
    float inv_eta = 1 / eta, ct = sqrtf(1 - (1 - cc * cc) * inv_eta * inv_eta);
    float rs = (cc - eta * ct) / (cc + eta * ct), rp = (eta * cc - ct) / (eta * cc + ct);
    return (struct eyed_normal){wx,
                                wy,
                                wz,
                                keep * nx + add * wx,
                                keep * ny + add * wy,
                                keep * nz + add * wz,
                                cc,
                                ct,
                                0.5f * (rs * rs + rp * rp)};
}

/* F_t of the view direction, the mirror direction, and the direction w_o' of the refracted path
 * inside, outwards. */
static void PRT_KERNEL(view_terms)(const struct shade_job *job, size_t at, int n,
                                   struct view_terms *v)
{
    const struct prt_gbuffer *g = job->g;
    const float *px = g->position[0] + at, *py = g->position[1] + at, *pz = g->position[2] + at;
    const float *nx = g->normal[0] + at, *ny = g->normal[1] + at, *nz = g->normal[2] + at;
    const float ex = job->eye[0], ey = job->eye[1], ez = job->eye[2];
    const float *facing = g->facing + at;
    float etas[LANES];
    PRT_KERNEL(gather)(job, job->eta, at, n, etas);
    for (int i = 0; i < n; i++) {
        const float eta = etas[i], inv_eta = 1 / eta;
        struct eyed_normal e = PRT_KERNEL(eyed_normal)(ex - px[i], ey - py[i], ez - pz[i],
                                                       nx[i], ny[i], nz[i], facing[i], eta);
        v->transmit[i] = 1 - e.mirror;
        v->mirror[i] = e.mirror;
        v->rx[i] = 2 * e.c * e.mx - e.wx;
        v->ry[i] = 2 * e.c * e.my - e.wy;
        v->rz[i] = 2 * e.c * e.mz - e.wz;
        float k = e.ct - e.c * inv_eta;
        v->ox[i] = e.wx * inv_eta + k * e.mx;
        v->oy[i] = e.wy * inv_eta + k * e.my;
        v->oz[i] = e.wz * inv_eta + k * e.mz;
    }
}

/* The mirror direction and the share reflected of a normal that a map turned. */
static void PRT_KERNEL(turn_mirror)(const struct shade_job *job, size_t at, int n,
                                    struct view_terms *v)
{
    const struct prt_gbuffer *g = job->g;
    const float *px = g->position[0] + at, *py = g->position[1] + at, *pz = g->position[2] + at;
    const float *tx = g->turned[0] + at, *ty = g->turned[1] + at, *tz = g->turned[2] + at;
    const float ex = job->eye[0], ey = job->eye[1], ez = job->eye[2], *facing = g->facing + at;
    float etas[LANES];
    PRT_KERNEL(gather)(job, job->eta, at, n, etas);
    for (int i = 0; i < n; i++) {
        struct eyed_normal e = PRT_KERNEL(eyed_normal)(ex - px[i], ey - py[i], ez - pz[i],
                                                       tx[i], ty[i], tz[i], facing[i], etas[i]);
        v->mirror[i] = e.mirror;
        v->rx[i] = 2 * e.c * e.mx - e.wx;
        v->ry[i] = 2 * e.c * e.my - e.wy;
        v->rz[i] = 2 * e.c * e.mz - e.wz;
    }
}

/* Radiance from the mirror direction at each point's own roughness: between two levels. */
static void PRT_KERNEL(fetch_levels)(const struct shade_job *job, size_t at, int n,
                                     const struct lookup *look, four *restrict rgb)
{
    float medium[LANES], share[LANES];
    int by[LANES];
    const float *own = job->g->roughness ? job->g->roughness + at : NULL;
    const float *variance = job->g->variance + at;
    PRT_KERNEL(gather)(job, job->roughness, at, n, medium);
    for (int i = 0; own && i < n; i++) medium[i] = own[i] >= 0 ? own[i] : medium[i];
    for (int i = 0; i < n; i++) {
        /* alpha^2 grows by the normals' variance over the pixel (METHODS §6) */
        float rough = medium[i], spread = variance[i] < 0.09f ? 2 * variance[i] : 0.18f;
        float wide = sqrtf(sqrtf(rough * rough * rough * rough + spread));
        float grows = (float)(spread > 1e-4f); /* a product: a branch is not vectorised */
        rough = grows * wide + (1 - grows) * rough;
        by[i] = (int)specular_level(rough, &share[i]) * job->level_floats;
    }
    for (int i = 0; i < n; i++) {
        const float *low = job->specular->texel + by[i] + look->first[i];
        const int row = job->specular->row;
        eight a, b;
        PRT_KERNEL(column8)(low, row, look->fy[i], &a);
        PRT_KERNEL(column8)(low + job->level_floats, row, look->fy[i], &b);
        PRT_KERNEL(mix8)(&a, &b, share[i]);
        rgb[i] = PRT_KERNEL(across)(&a, look->fx[i]);
    }
}

/* Light after scattering times base colour; occlusion of light that the surface reflects. */
static void PRT_KERNEL(apply_look)(const struct shade_job *job, size_t at, int n, four *rgb,
                                   four *mirror)
{
    const struct prt_gbuffer *s = job->g;
    const uint8_t *opaque = s->opaque + at;
    const float *occlusion = s->occlusion ? s->occlusion + at : NULL;
    for (int i = 0; s->base[0] && i < n; i++) {
        const size_t k = at + (size_t)i;
        rgb[i] *= (four){s->base[0][k], s->base[1][k], s->base[2][k], 0};
    }
    for (int i = 0; occlusion && i < n; i++) {
        rgb[i] *= opaque[i] ? occlusion[i] : 1;
        mirror[i] *= occlusion[i];
    }
}

/* Vertex values of a plane at the corners c, weighted. */
static inline __attribute__((always_inline)) four
PRT_KERNEL(corners)(const float *plane, const size_t c[3], const float b[3], size_t last)
{
    four sum = b[0] * PRT_KERNEL(load3)(plane, c[0], last);
    sum += b[1] * PRT_KERNEL(load3)(plane, c[1], last);
    return sum + b[2] * PRT_KERNEL(load3)(plane, c[2], last);
}

/* Vertex values of the planes, interpolated: the first, and the others times y. */
static void PRT_KERNEL(add_planes)(const struct shade_job *job, size_t at, int n,
                                   float y[4][LANES][4], four *restrict rgb)
{
    const struct prt_gbuffer *s = job->g;
    const uint32_t *v0 = s->corner[0] + at, *v1 = s->corner[1] + at, *v2 = s->corner[2] + at;
    const float *w1 = s->bary[0] + at, *w2 = s->bary[1] + at;
    const size_t last = job->plane_floats - 4; /* a triangle has three vertices */
    const unsigned n_plane = job->n_plane;
    for (int i = 0; i < n; i++) {
        const float b[3] = {1 - w1[i] - w2[i], w1[i], w2[i]};
        const size_t c[3] = {3 * (size_t)v0[i], 3 * (size_t)v1[i], 3 * (size_t)v2[i]};
        const bool whole = c[0] <= last && c[1] <= last && c[2] <= last;
        const float *plane = job->planes;
        four sum = PRT_KERNEL(corners)(plane, c, b, last);
        for (unsigned k = 1; whole && k < n_plane; k++) {
            plane += job->plane_floats;
            four one = b[0] * PRT_KERNEL(load4)(plane + c[0]);
            one += b[1] * PRT_KERNEL(load4)(plane + c[1]);
            one += b[2] * PRT_KERNEL(load4)(plane + c[2]);
            sum += y[k / 4][i][k % 4] * one;
        }
        for (unsigned k = 1; !whole && k < n_plane; k++)
            sum += y[k / 4][i][k % 4] *
                   PRT_KERNEL(corners)(job->planes + k * job->plane_floats, c, b, last);
        rgb[i] = sum;
    }
}

/* The same from job->packed, which has four planes of a channel side by side: a third of the
 * cache lines. y of plane k is y[k / 4][i][k % 4], with 1 for the first. */
static void PRT_KERNEL(add_packed)(const struct shade_job *job, size_t at, int n,
                                   float y[4][LANES][4], four *restrict rgb)
{
    const struct prt_gbuffer *s = job->g;
    const uint32_t *v0 = s->corner[0] + at, *v1 = s->corner[1] + at, *v2 = s->corner[2] + at;
    const float *w1 = s->bary[0] + at, *w2 = s->bary[1] + at;
    const size_t step = PACKED_FLOATS * (size_t)job->n_group;
    for (int i = 0; i < n; i++) {
        const float b0 = 1 - w1[i] - w2[i], b1 = w1[i], b2 = w2[i];
        const float *p0 = job->packed + step * v0[i], *p1 = job->packed + step * v1[i],
                    *p2 = job->packed + step * v2[i];
        eight red_green = {0};
        four blue = {0};
        for (unsigned k = 0; k < job->n_group; k++, p0 += 12, p1 += 12, p2 += 12) {
            const four weight = PRT_KERNEL(load4)(y[k][i]);
            eight one = b0 * *(const loose_eight *)p0;
            four last = b0 * PRT_KERNEL(load4)(p0 + 8);
            one += b1 * *(const loose_eight *)p1;
            last += b1 * PRT_KERNEL(load4)(p1 + 8);
            one += b2 * *(const loose_eight *)p2;
            last += b2 * PRT_KERNEL(load4)(p2 + 8);
            red_green += __builtin_shufflevector(weight, weight, 0, 1, 2, 3, 0, 1, 2, 3) * one;
            blue += weight * last;
        }
        const four sum[3] = {__builtin_shufflevector(red_green, red_green, 0, 1, 2, 3),
                             __builtin_shufflevector(red_green, red_green, 4, 5, 6, 7), blue};
        /* the sum of each of the three, by transposing */
        const four none = {0, 0, 0, 0};
        four low = __builtin_shufflevector(sum[0], sum[1], 0, 4, 1, 5) +
                   __builtin_shufflevector(sum[0], sum[1], 2, 6, 3, 7);
        four high = __builtin_shufflevector(sum[2], none, 0, 4, 1, 5) +
                    __builtin_shufflevector(sum[2], none, 2, 6, 3, 7);
        rgb[i] = __builtin_shufflevector(low, high, 0, 1, 4, 5) +
                 __builtin_shufflevector(low, high, 2, 3, 6, 7);
    }
}

/* Real spherical harmonics l = 1..3 of the outward inside direction; y[k / 4][i][k % 4] for
 * plane k, with 1 for the first and 0 behind the last. */
static void PRT_KERNEL(harmonics)(const struct view_terms *v, int n, unsigned n_plane,
                                  const float *sign, float y[4][LANES][4])
{
    for (int i = 0; i < n; i++) {
        float x = v->ox[i], yy = v->oy[i], z = v->oz[i];
        y[0][i][0] = 1;
        y[0][i][1] = sign[1] * 0.48860251190f * yy;
        y[0][i][2] = sign[2] * 0.48860251190f * z;
        y[0][i][3] = sign[3] * 0.48860251190f * x;
    }
    if (n_plane <= 4) return;
    for (int i = 0; i < n; i++) {
        float x = v->ox[i], yy = v->oy[i], z = v->oz[i];
        y[1][i][0] = sign[4] * 1.09254843059f * x * yy;
        y[1][i][1] = sign[5] * 1.09254843059f * yy * z;
        y[1][i][2] = sign[6] * 0.31539156525f * (3 * z * z - 1);
        y[1][i][3] = sign[7] * 1.09254843059f * x * z;
        y[2][i][0] = sign[8] * 0.54627421530f * (x * x - yy * yy);
        for (int k = 1; k < 4; k++) y[2][i][k] = 0;
    }
    if (n_plane <= 9) return;
    for (int i = 0; i < n; i++) {
        float x = v->ox[i], yy = v->oy[i], z = v->oz[i];
        y[2][i][1] = sign[9] * 0.59004358993f * yy * (3 * x * x - yy * yy);
        y[2][i][2] = sign[10] * 2.89061144264f * x * yy * z;
        y[2][i][3] = sign[11] * 0.45704579946f * yy * (5 * z * z - 1);
        y[3][i][0] = sign[12] * 0.37317633259f * z * (5 * z * z - 3);
        y[3][i][1] = sign[13] * 0.45704579946f * x * (5 * z * z - 1);
        y[3][i][2] = sign[14] * 1.44530572132f * z * (x * x - yy * yy);
        y[3][i][3] = sign[15] * 0.59004358993f * x * (x * x - 3 * yy * yy);
    }
}

/* Radiance of points [at, at+n), n <= LANES. */
static void PRT_KERNEL(shade_points)(const struct shade_job *job, size_t at, int n,
                                     four *restrict rgb)
{
    struct view_terms v;
    four mirrored[LANES];
    PRT_KERNEL(view_terms)(job, at, n, &v);
    const uint8_t *opaque = job->g->opaque + at;
    uint8_t any_opaque = 0;
    for (int i = 0; i < n; i++) any_opaque |= opaque[i];
    if (job->radiance) {
        const float(*given)[3] = job->radiance + at;
        for (int i = 0; i < n; i++) rgb[i] = (four){given[i][0], given[i][1], given[i][2], 0};
    } else {
        float y[4][LANES][4];
        if (job->n_plane > 1) PRT_KERNEL(harmonics)(&v, n, job->n_plane, job->sign, y);
        for (unsigned k = 1; any_opaque && k < job->n_plane; k++)
            for (int i = 0; i < n; i++) y[k / 4][i][k % 4] *= opaque[i] ? 0 : 1;
        if (job->packed) PRT_KERNEL(add_packed)(job, at, n, y, rgb);
        else PRT_KERNEL(add_planes)(job, at, n, y, rgb);
    }
    if (job->specular) {
        struct lookup look;
        if (job->g->turned[0]) PRT_KERNEL(turn_mirror)(job, at, n, &v);
        const float cosine = job->lobe_cos, sine = job->lobe_sin;
        for (int i = 0; i < n; i++) { /* as the background's rays */
            const float x = v.rx[i], z = v.rz[i];
            v.rx[i] = x * cosine - z * sine;
            v.rz[i] = x * sine + z * cosine;
        }
        PRT_KERNEL(cube_lookup)(job->specular, n, v.rx, v.ry, v.rz, &look);
        PRT_KERNEL(fetch_levels)(job, at, n, &look, mirrored);
        const float *open = job->g->unblocked ? job->g->unblocked + at : NULL;
        for (int i = 0; open && i < n; i++) mirrored[i] *= open[i];
    } else {
        for (int i = 0; i < n; i++) mirrored[i] = (four){0, 0, 0, 0};
    }
    if (job->g->base[0] || job->g->occlusion) PRT_KERNEL(apply_look)(job, at, n, rgb, mirrored);
    float leaves[LANES];
    PRT_KERNEL(gather)(job, job->exit, at, n, leaves);
    for (int i = 0; i < n; i++) leaves[i] = leaves[i] > 0 ? leaves[i] * v.transmit[i] : 1;
    for (int i = 0; any_opaque && i < n; i++) {
        leaves[i] = opaque[i] ? 1 : leaves[i];
        v.mirror[i] = opaque[i] ? 0 : v.mirror[i];
    }
    for (int i = 0; i < n; i++) {
        const four zero = {0, 0, 0, 0}, body = leaves[i] * rgb[i];
        rgb[i] = (four)((four_bits)body & (body > zero)) + v.mirror[i] * mirrored[i];
    }
    const struct prt_gbuffer *s = job->g;
    for (int i = 0; s->emission[0] && i < n; i++) {
        const size_t k = at + (size_t)i;
        rgb[i] += (four){s->emission[0][k], s->emission[1][k], s->emission[2][k], 0};
    }
}

/* Background radiance of n pixels of row y at columns x. */
static void PRT_KERNEL(background)(const struct shade_job *job, uint32_t y, int n,
                                   const uint32_t *x, four *rgb)
{
    const struct camera_frame *f = job->frame;
    float dx[LANES], dy[LANES], dz[LANES];
    dx[0] = dy[0] = dz[0] = 0; /* gcc warns that n may be 0; clearing all is slow */
    const float v = 1 - 2 * ((float)y + 0.5f) / (float)job->height;
    const float cx = (float)(f->forward[0] + (double)v * f->up[0] - f->right[0]);
    const float oy = (float)(f->forward[1] + (double)v * f->up[1] - f->right[1]);
    const float cz = (float)(f->forward[2] + (double)v * f->up[2] - f->right[2]);
    const float k = 2 / (float)job->width, bx = (float)f->right[0] * k;
    const float ay = (float)f->right[1] * k, bz = (float)f->right[2] * k;
    /* rotating the background is rotating the rays by the opposite angle */
    const float ox = cx * job->sky_cos - cz * job->sky_sin;
    const float oz = cx * job->sky_sin + cz * job->sky_cos;
    const float ax = bx * job->sky_cos - bz * job->sky_sin;
    const float az = bx * job->sky_sin + bz * job->sky_cos;
    for (int i = 0; i < n; i++) {
        float u = (float)x[i] + 0.5f;
        dx[i] = ox + u * ax;
        dy[i] = oy + u * ay;
        dz[i] = oz + u * az;
    }
    struct lookup look;
    PRT_KERNEL(cube_lookup)(job->background, n, dx, dy, dz, &look);
    PRT_KERNEL(cube_fetch)(job->background, n, &look, rgb);
}

/* The background of n <= LANES pixels of row y. */
static void PRT_KERNEL(behind)(const struct shade_job *job, uint32_t y, int n,
                               const uint32_t *x, four *rgb)
{
    const four plain = {job->plain[0], job->plain[1], job->plain[2], 0};
    if (job->background) PRT_KERNEL(background)(job, y, n, x, rgb);
    for (int i = 0; !job->background && i < n; i++) rgb[i] = plain;
    for (int i = 0; job->shadow && i < n; i++) {
        const float *left = job->shadow + 3 * ((size_t)y * job->width + x[i]);
        rgb[i] *= (four){left[0], left[1], left[2], 0};
    }
}

/* The share of a pixel that surfaces cover, and of the rest that a shadow takes. */
static void PRT_KERNEL(set_alpha)(const struct shade_job *job, size_t pixel, float left)
{
    const float *shadow = job->shadow ? job->shadow + 3 * pixel : NULL;
    float lost = shadow ? 1 - (shadow[0] + shadow[1] + shadow[2]) / 3 : 0;
    job->alpha[pixel] = 1 - left * (1 - lost);
}

/* Three floats each of n pixels side by side. */
static inline __attribute__((always_inline)) void
PRT_KERNEL(store_side_by_side)(float *restrict to, int n, const four *restrict rgb)
{
    int i = 0;
    for (; i + 4 <= n; i += 4, to += 12) {
        const four a = rgb[i], b = rgb[i + 1], c = rgb[i + 2], d = rgb[i + 3];
        *(loose_four *)to = __builtin_shufflevector(a, b, 0, 1, 2, 4);
        *(loose_four *)(to + 4) = __builtin_shufflevector(b, c, 1, 2, 4, 5);
        *(loose_four *)(to + 8) = __builtin_shufflevector(c, d, 2, 4, 5, 6);
    }
    for (; i < n; i++, to += 3) PRT_KERNEL(store3)(to, rgb[i]);
}

/* Columns [from, to), which no point covers. */
static void PRT_KERNEL(fill_gap)(const struct shade_job *job, uint32_t y, uint32_t from,
                                 uint32_t to, float *row)
{
    uint32_t x[LANES];
    four rgb[LANES];
    for (; from < to; from += LANES) {
        const int n = to - from < LANES ? (int)(to - from) : LANES;
        for (int i = 0; i < n; i++) x[i] = from + (uint32_t)i;
        PRT_KERNEL(behind)(job, y, n, x, rgb);
        PRT_KERNEL(store_side_by_side)(row + 3 * (size_t)from, n, rgb);
        for (int i = 0; job->alpha && i < n; i++)
            PRT_KERNEL(set_alpha)(job, (size_t)y * job->width + x[i], 1);
    }
}

/* Pixels of which points cover a part: adds the background's share. */
struct PRT_KERNEL(edges) {
    uint32_t x[LANES];
    float left[LANES];
    int n;
};

static void PRT_KERNEL(add_edges)(const struct shade_job *job, uint32_t y,
                                  struct PRT_KERNEL(edges) * e, float *row)
{
    four rgb[LANES];
    if (e->n) PRT_KERNEL(behind)(job, y, e->n, e->x, rgb);
    for (int i = 0; i < e->n; i++) {
        float *p = row + 3 * (size_t)e->x[i];
        for (int c = 0; c < 3; c++) p[c] += e->left[i] * rgb[i][c];
    }
    e->n = 0;
}

/* A pixel whose points have all been added. */
static void PRT_KERNEL(end_pixel)(const struct shade_job *job, uint32_t y, uint32_t x, four sum,
                                  float left, struct PRT_KERNEL(edges) * e, float *row)
{
    PRT_KERNEL(store3)(row + 3 * (size_t)x, sum);
    if (job->alpha) PRT_KERNEL(set_alpha)(job, (size_t)y * job->width + x, left);
    if (!(left > 1e-3f)) return;
    e->x[e->n] = x;
    e->left[e->n++] = left;
    if (e->n == LANES) PRT_KERNEL(add_edges)(job, y, e, row);
}

/* One row of the image: points by their weights, the rest of each pixel by the background. */
static void PRT_KERNEL(shade_row)(const struct shade_job *job, uint32_t y, float *row)
{
    const size_t begin = job->vis->row_point[y], end = job->vis->row_point[y + 1];
    const uint32_t *pixel = job->g->pixel, first = y * job->width;
    struct PRT_KERNEL(edges) edges = {.n = 0};
    four rgb[LANES], sum = {0, 0, 0, 0};
    float left = 1;
    uint32_t x = 0; /* up to which the row is complete */
    for (size_t at = begin; at < end; at += LANES) {
        const int n = end - at < LANES ? (int)(end - at) : LANES;
        PRT_KERNEL(shade_points)(job, at, n, rgb);
        for (int i = 0; i < n; i++) {
            const size_t p = at + (size_t)i;
            const uint32_t here = pixel[p] - first;
            const float w = job->g->weight[p];
            if (here > x) PRT_KERNEL(fill_gap)(job, y, x, here, row);
            sum += w * rgb[i];
            left -= w;
            x = here;
            if (p + 1 < end && pixel[p + 1] == pixel[p]) continue; /* more of the pixel */
            PRT_KERNEL(end_pixel)(job, y, here, sum, left, &edges, row);
            sum = (four){0, 0, 0, 0};
            left = 1;
            x = here + 1;
        }
    }
    PRT_KERNEL(fill_gap)(job, y, x, job->width, row);
    PRT_KERNEL(add_edges)(job, y, &edges, row);
}
