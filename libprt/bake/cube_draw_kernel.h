/* SPDX-License-Identifier: MIT */
/* Drawing triangles on a cube, as plain loops over 16 lanes; included by cube_draw.c once for
 * each instruction set, in its region of base/isa.h. */

// out[c] = the cross product of the two corners after c.
PRT_INLINE void PRT_KERNEL(crosses)(const float v[3][3][16], float out[3][3][16])
{
    for (int c = 0; c < 3; c++) {
        const float(*a)[16] = v[(c + 1) % 3], (*b)[16] = v[(c + 2) % 3];
        for (int i = 0; i < 16; i++) {
            out[c][0][i] = a[1][i] * b[2][i] - a[2][i] * b[1][i];
            out[c][1][i] = a[2][i] * b[0][i] - a[0][i] * b[2][i];
            out[c][2][i] = a[0][i] * b[1][i] - a[1][i] * b[0][i];
        }
    }
}

// Planes through the point and two corners of each of 16 triangles. Towards d, the dot products
// with the three are the shares of the corners times 1/r, where d r is the triangle's point;
// all are positive where the triangle is seen. And the window of texels of each face that a
// triangle may cover; high_x < 0: none.
static void PRT_KERNEL(project)(const struct nearby *near, uint32_t first, const float from[3],
                                uint32_t n, float *const plane[3][3],
                                struct window_lanes out[6])
{
    float v[3][3][16], scale[16];
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 16; i++) v[c][k][i] = near->corner[c][k][first + i] - from[k];
    float p[3][3][16];
    PRT_KERNEL(crosses)(v, p);
    for (int i = 0; i < 16; i++) {
        float volume =
            v[0][0][i] * p[0][0][i] + v[0][1][i] * p[0][1][i] + v[0][2][i] * p[0][2][i];
        bool flat = volume * volume < 1e-37f; // seen edge-on, or without area
        scale[i] = flat ? 0 : 1 / (flat ? 1 : volume);
    }
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 16; i++) plane[c][k][first + i] = p[c][k][i] * scale[i];
    float inverse[3][3][16]; // of the corners' coordinates
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 16; i++)
                inverse[c][k][i] = 1 / (v[c][k][i] == 0 ? 1 : v[c][k][i]);
    const float half = 0.5f * (float)n, last = (float)(n - 1);
    for (int f = 0; f < 6; f++) {
        const struct face_axes *axes = &face_axes[f];
        const float *s0 = v[0][axes->s], *s1 = v[1][axes->s], *s2 = v[2][axes->s];
        const float *t0 = v[0][axes->t], *t1 = v[1][axes->t], *t2 = v[2][axes->t];
        const float *m0 = v[0][axes->m], *m1 = v[1][axes->m], *m2 = v[2][axes->m];
        const float *i0 = inverse[0][axes->m], *i1 = inverse[1][axes->m];
        const float *i2 = inverse[2][axes->m];
        const float ss = axes->sign_s, st = axes->sign_t, sm = axes->sign_m;
        uint32_t beside[16], any = 0;
        for (int i = 0; i < 16; i++) {
            float a = ss * s0[i], b = ss * s1[i], c = ss * s2[i];
            float d = st * t0[i], e = st * t1[i], g = st * t2[i];
            float x = sm * m0[i], y = sm * m1[i], z = sm * m2[i];
            beside[i] = (most3(x, y, z) <= 0) | (scale[i] == 0) |
                        (least3(a - x, b - y, c - z) > 0) | (most3(a + x, b + y, c + z) < 0) |
                        (least3(d - x, e - y, g - z) > 0) | (most3(d + x, e + y, g + z) < 0);
        }
        for (int i = 0; i < 16; i++) any |= !beside[i];
        for (int i = 0; i < 16; i++) out[f].high_x[i] = -1;
        if (!any) continue; // triangles near one another are on few faces
        for (int i = 0; i < 16; i++) {
            float a = ss * s0[i], b = ss * s1[i], c = ss * s2[i];
            float d = st * t0[i], e = st * t1[i], g = st * t2[i];
            float x = sm * m0[i], y = sm * m1[i], z = sm * m2[i];
            float low = least3(x, y, z), high = most3(x, y, z);
            bool out_of_face = beside[i] != 0;
            // A triangle that reaches behind the face's eye may cover all of it.
            bool ahead = low > 1e-3f * high;
            float ix = sm * i0[i], iy = sm * i1[i], iz = sm * i2[i];
            float s_low = least3(a * ix, b * iy, c * iz);
            float s_high = most3(a * ix, b * iy, c * iz);
            float t_low = least3(d * ix, e * iy, g * iz);
            float t_high = most3(d * ix, e * iy, g * iz);
            s_low = ahead ? s_low : -1, s_high = ahead ? s_high : 1;
            t_low = ahead ? t_low : -1, t_high = ahead ? t_high : 1;
            float margin = 1e-3f; // of a texel, for rounding
            float x_low = half * (s_low + 1) - margin, x_high = half * (s_high + 1) + margin;
            float y_low = half * (t_low + 1) - margin, y_high = half * (t_high + 1) + margin;
            out_of_face |=
                (x_high < 0) | (y_high < 0) | (x_low > last + 1) | (y_low > last + 1);
            out[f].low_x[i] = (int)within(x_low, last);
            out[f].low_y[i] = (int)within(y_low, last);
            out[f].high_x[i] = out_of_face ? -1 : (int)within(x_high, last);
            out[f].high_y[i] = (int)within(y_high, last);
        }
    }
}

// Draws the windows: at each texel the triangle of the greatest nearness remains.
static void PRT_KERNEL(draw)(const struct draw_window *window, uint32_t n_window,
                             float *const plane[3][3], const float *slope, uint32_t n,
                             float *restrict nearness, uint32_t *restrict at)
{
    const uint32_t n_coef = 6 * n * n, wide = PRT_ISA_LANES;
    for (uint32_t w = 0; w < n_window; w++) {
        const struct draw_window *win = &window[w];
        const struct face_axes *axes = &face_axes[win->face];
        const uint32_t k = win->triangle;
        float s[3], t[3], m[3];
        for (int c = 0; c < 3; c++) {
            s[c] = axes->sign_s * plane[c][axes->s][k];
            t[c] = axes->sign_t * plane[c][axes->t][k];
            m[c] = axes->sign_m * plane[c][axes->m][k];
        }
        for (uint32_t y = win->low_y; y <= win->high_y; y++)
            for (uint32_t x = win->low_x / wide * wide; x <= win->high_x; x += wide) {
                size_t first = ((size_t)win->face * n + y) * n + x;
                const float *sx = slope + first, *ty = slope + n_coef + first;
                float *best = nearness + first;
                uint32_t *of = at + first;
                for (uint32_t i = 0; i < wide; i++) {
                    float a = s[0] * sx[i] + (t[0] * ty[i] + m[0]);
                    float b = s[1] * sx[i] + (t[1] * ty[i] + m[1]);
                    float c = s[2] * sx[i] + (t[2] * ty[i] + m[2]);
                    float near = a + b + c;
                    bool seen = (a >= 0) & (b >= 0) & (c >= 0) & (near > best[i]);
                    best[i] = seen ? near : best[i];
                    of[i] = seen ? k : of[i];
                }
            }
    }
}

static uint32_t PRT_KERNEL(look)(const struct drawing *drawing, const uint32_t texel[16],
                                 const float length[16], float most, float t[16],
                                 uint32_t at[16])
{
    const float *nearness = drawing->nearness;
    const float certain = drawing->certain_mm, reach = certain < most ? certain : most;
    const bool all = certain >= most;
    uint32_t known[16], mask = 0;
    for (int i = 0; i < 16; i++) {
        float near = nearness[texel[i]];
        bool seen = near * reach > length[i];
        t[i] = length[i] / (seen ? near : 1);
        at[i] = seen ? drawing->at[texel[i]] : UINT32_MAX;
        known[i] = seen | all;
    }
    for (int i = 0; i < 16; i++) mask |= known[i] << i;
    return mask;
}

static void PRT_KERNEL(hits)(const struct nearby *near, const float from[3],
                             const uint32_t at[16], const float t[16],
                             struct prt_packet *packet, struct corners *normals)
{
    uint32_t of[16];
    float v[3][3][16], n[3][3][16];
    for (int i = 0; i < 16; i++) of[i] = at[i] == UINT32_MAX ? 0 : at[i];
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++) {
            const float *corner = near->corner[c][k], *normal = near->normal[c][k];
            for (int i = 0; i < 16; i++) v[c][k][i] = corner[of[i]] - from[k];
            for (int i = 0; i < 16; i++) normals->n[c][k][i] = normal[of[i]];
        }
    PRT_KERNEL(crosses)(v, n);
    for (int i = 0; i < 16; i++) {
        float x = packet->dx[i], y = packet->dy[i], z = packet->dz[i];
        float a = n[0][0][i] * x + n[0][1][i] * y + n[0][2][i] * z;
        float b = n[1][0][i] * x + n[1][1][i] * y + n[1][2][i] * z;
        float c = n[2][0][i] * x + n[2][1][i] * y + n[2][2][i] * z;
        float sum = a + b + c, inverse = 1 / (sum * sum > 0 ? sum : 1);
        packet->t[i] = t[i];
        packet->u[i] = b * inverse, packet->v[i] = c * inverse;
        // The normal of the plane: the sum of the three cross products.
        packet->gx[i] = n[0][0][i] + n[1][0][i] + n[2][0][i];
        packet->gy[i] = n[0][1][i] + n[1][1][i] + n[2][1][i];
        packet->gz[i] = n[0][2][i] + n[1][2][i] + n[2][2][i];
        uint32_t triangle = near->triangle[of[i]];
        packet->triangle[i] = at[i] == UINT32_MAX ? UINT32_MAX : triangle;
    }
}

static const struct draw_loops PRT_KERNEL(draw_loops) = {PRT_KERNEL(project), PRT_KERNEL(draw),
                                                         PRT_KERNEL(look), PRT_KERNEL(hits)};
