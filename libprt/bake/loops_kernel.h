/* SPDX-License-Identifier: MIT */
/* The inner loops of the bake as plain loops over lanes; included by loops.c once for each
 * instruction set, in its region of base/isa.h. */

/* ---- rays ---- */

// Light of a packet's four texels through the lanes of `open`: the sums of F_t (n.w)+ and the
// weight, of directions above the face's plane. Returns the lanes that are. n, f: normals of
// the shading and the face. fresnel NULL: F_t = 1.
static uint32_t PRT_KERNEL(light_texels)(const struct directions *d, size_t at,
                                         const float n[3], const float f[3],
                                         const struct fresnel_table *fresnel, uint32_t open,
                                         float sum[4])
{
    const float *x = d->x + at, *y = d->y + at, *z = d->z + at, *weight = d->weight + at;
    const float n0 = n[0], n1 = n[1], n2 = n[2], f0 = f[0], f1 = f[1], f2 = f[2];
    float c[16], value[16];
    uint32_t mask = 0;
    for (int i = 0; i < 16; i++) {
        float cosine = n0 * x[i] + n1 * y[i] + n2 * z[i];
        float horizon = f0 * x[i] + f1 * y[i] + f2 * z[i];
        cosine = horizon > 0 ? cosine : 0;
        cosine = cosine > 0 ? cosine : 0;
        c[i] = cosine < 1 ? cosine : 1;
    }
    for (int i = 0; i < 16; i++) value[i] = open >> i & 1 ? c[i] * weight[i] : 0;
    for (int i = 0; fresnel && i < 16; i++) value[i] *= fresnel_table_eval(fresnel, c[i]);
    for (int i = 0; i < 16; i++) mask |= (uint32_t)(c[i] > 0) << i;
    for (int j = 0; j < 4; j++)
        sum[j] = (value[4 * j] + value[4 * j + 1]) + (value[4 * j + 2] + value[4 * j + 3]);
    return mask;
}

// Directions of the pattern's rays with these numbers, their texels, and the lengths of
// (s, t, 1) on the faces. slope: prt_direction_slopes. The choices are those of
// prt_cube_direction.
static void PRT_KERNEL(aim)(const struct directions *d, const float *slope,
                            const uint32_t number[16], struct prt_packet *packet,
                            uint32_t texel[16], float length[16])
{
    const unsigned log_n = (unsigned)__builtin_ctz(d->n);
    const uint32_t half = d->n / 2;
    for (int i = 0; i < 16; i++) {
        uint32_t block = number[i] >> 2, y = block >> (log_n - 1), x = block & (half - 1);
        texel[i] = ((2 * y + (number[i] >> 1 & 1)) << log_n) + 2 * x + (number[i] & 1);
    }
    for (int i = 0; i < 16; i++) {
        const uint32_t face = texel[i] >> 2 * log_n;
        const float s = slope[texel[i]], t = slope[d->n_coef + texel[i]];
        const float r = sqrtf(1 + s * s + t * t), inverse = 1 / r;
        const float side = face & 1 ? -1 : 1;
        const float x = face < 2 ? side : face == 5 ? -s : s;
        const float y = (face | 1) == 3 ? side : -t;
        const float z = face < 2 ? -side * s : face < 4 ? side * t : side;
        packet->dx[i] = x * inverse, packet->dy[i] = y * inverse, packet->dz[i] = z * inverse;
        length[i] = r;
    }
}

// Path lengths s_i' (METHODS §1, W05 eq 5), refracted directions and F_t of 16 rays. The cosine
// is 0 where the ray hit a front face (its start is outside) or leaves below the shading
// normal's horizon. Returns the lanes that leave the body.
static uint32_t PRT_KERNEL(refract)(const struct prt_packet *packet,
                                    const struct corners *corner, float eta,
                                    const struct fresnel_table *fresnel, float far_mm,
                                    struct lanes *out)
{
    float inv = 1 / eta;
    uint32_t leave = 0;
    for (int i = 0; i < 16; i++) {
        float u = packet->u[i], v = packet->v[i], o = 1 - u - v;
        float dx = packet->dx[i], dy = packet->dy[i], dz = packet->dz[i];
        float x = o * corner->n[0][0][i] + u * corner->n[1][0][i] + v * corner->n[2][0][i];
        float y = o * corner->n[0][1][i] + u * corner->n[1][1][i] + v * corner->n[2][1][i];
        float z = o * corner->n[0][2][i] + u * corner->n[1][2][i] + v * corner->n[2][2][i];
        float length2 = x * x + y * y + z * z;
        float facing = packet->gx[i] * dx + packet->gy[i] * dy + packet->gz[i] * dz;
        float scale = 1 / sqrtf(length2 + 1e-30f);
        x *= scale, y *= scale, z *= scale;
        float cosine = x * dx + y * dy + z * dz;
        cosine = cosine > 1 ? 1 : cosine;
        bool leaves = packet->triangle[i] != UINT32_MAX && facing > 0 && cosine > 0;
        // not 1 - inv^2 (1 - cos^2), which is 0 for grazing rays at eta 1
        float root = sqrtf((1 - inv * inv) + inv * inv * cosine * cosine + 1e-20f);
        float bend = root - cosine * inv;
        out->cosine[i] = leaves ? cosine : 0;
        out->path_mm[i] = leaves ? packet->t[i] * cosine / root : 0;
        // The refracted direction, pointing back outwards: w/eta + (root - cos/eta) n.
        out->dir[0][i] = dx * inv + bend * x;
        out->dir[1][i] = dy * inv + bend * y;
        out->dir[2][i] = dz * inv + bend * z;
    }
    for (int i = 0; i < 16; i++) {
        const bool found = out->path_mm[i] > 0;
        const float transmittance = fresnel_table_eval(fresnel, out->cosine[i]);
        out->transmittance[i] = found ? transmittance : 0;
        out->path_mm[i] = found ? out->path_mm[i] : far_mm;
        for (int k = 0; k < 3; k++) out->dir[k][i] = found ? out->dir[k][i] : 0;
    }
    for (int i = 0; i < 16; i++) leave |= (uint32_t)(out->cosine[i] > 0) << i;
    return leave;
}

// Transmittance times attenuation at the first texel of each square of stride x stride texels.
static void PRT_KERNEL(attenuate)(const struct exits *e, uint32_t n, uint32_t stride,
                                  float weakest, float depth, float *restrict out)
{
    const uint32_t wide = n / stride;
    for (uint32_t row = 0; row < 6 * wide; row++) {
        const float *path_mm = e->path_mm + (size_t)row * stride * n;
        const float *transmittance = e->transmittance + (size_t)row * stride * n;
        for (uint32_t x = 0; x < wide; x++)
            out[row * wide + x] =
                transmittance[x * stride] * exp_minus(weakest * (path_mm[x * stride] + depth));
    }
}

// The most that each cell differs from its neighbours on its face; 6 faces of wide x wide.
static void PRT_KERNEL(steps)(const float *restrict value, uint32_t wide, float *restrict step)
{
    for (uint32_t row = 0; row < 6 * wide; row++) {
        const uint32_t y = row % wide;
        const float *v = value + (size_t)row * wide;
        const float *up = y ? v - wide : v, *down = y + 1 < wide ? v + wide : v;
        float *out = step + (size_t)row * wide;
        for (uint32_t x = 0; x < wide; x++) {
            float a = fabsf(v[x] - up[x]), b = fabsf(v[x] - down[x]);
            out[x] = a > b ? a : b;
        }
        for (uint32_t x = 1; x < wide; x++) {
            float a = fabsf(v[x] - v[x - 1]);
            out[x] = a > out[x] ? a : out[x];
        }
        for (uint32_t x = 0; x + 1 < wide; x++) {
            float a = fabsf(v[x] - v[x + 1]);
            out[x] = a > out[x] ? a : out[x];
        }
    }
}

/* ---- paths ---- */

// Slope at a point between two chords of a monotone cubic (FC80).
PRT_INLINE float PRT_KERNEL(pchip)(float h0, float h1, float m0, float m1)
{
    float w0 = 2 * h1 + h0, w1 = h1 + 2 * h0, low = w0 * m1 + w1 * m0;
    return m0 * m1 > 0 ? (w0 + w1) * m0 * m1 / low : 0;
}

// Evaluates the cubic at `substeps` points of every interval between the knots.
static void PRT_KERNEL(subdivide)(const struct knots *k, uint32_t n_node, uint32_t substeps,
                                  float out[PATH_POINTS][PATH_TILE])
{
    float chord[SINGLE_MAX_NODES][PATH_TILE], from[PATH_TILE], to[PATH_TILE];
    for (uint32_t a = 0; a < n_node; a++) {
        float inv = 1 / (k->depth[a + 1] - k->depth[a]);
        for (int t = 0; t < PATH_TILE; t++) chord[a][t] = (k->v[a + 1][t] - k->v[a][t]) * inv;
    }
    memcpy(from, chord[0], sizeof from);
    memcpy(out[0], k->v[0], sizeof out[0]);
    for (uint32_t a = 0; a < n_node; a++) {
        float h = k->depth[a + 1] - k->depth[a];
        float h1 = a + 1 < n_node ? k->depth[a + 2] - k->depth[a + 1] : h;
        const float *next = chord[a + 1 < n_node ? a + 1 : a];
        for (int t = 0; t < PATH_TILE; t++)
            to[t] = PRT_KERNEL(pchip)(h, h1, chord[a][t], next[t]);
        for (uint32_t i = 1; i <= substeps; i++) {
            float x = (float)i / (float)substeps, x2 = x * x, x3 = x2 * x;
            float h00 = 2 * x3 - 3 * x2 + 1, h01 = 3 * x2 - 2 * x3;
            float h10 = (x3 - 2 * x2 + x) * h, h11 = (x3 - x2) * h;
            float *at = out[a * substeps + i];
            for (int t = 0; t < PATH_TILE; t++)
                at[t] = h00 * k->v[a][t] + h10 * from[t] + h01 * k->v[a + 1][t] + h11 * to[t];
        }
        memcpy(from, to, sizeof from);
    }
}

// The integral along the path for isotropic phase: one channel of a tile, times factor.
static void PRT_KERNEL(integrate_isotropic)(const struct path *path, float sigma_t,
                                            float factor, float end, float sum[PATH_TILE])
{
    float exponent[PATH_TILE], before[PATH_TILE];
    uint32_t n = path->n_point;
    for (int t = 0; t < PATH_TILE; t++) {
        exponent[t] = sigma_t * path->u[0][t];
        before[t] = exp_minus(exponent[t]);
        sum[t] = 0;
    }
    for (uint32_t i = 1; i < n; i++) {
        float step = 0.5f * (path->depth[i] - path->depth[i - 1]);
        const float *u = path->u[i], *o0 = path->transmittance[i - 1],
                    *o1 = path->transmittance[i];
        for (int t = 0; t < PATH_TILE; t++) {
            float next = sigma_t * u[t], e = exp_minus(next);
            sum[t] += step * mean_exp(before[t], e, exponent[t], next) * (o0[t] + o1[t]);
            exponent[t] = next, before[t] = e;
        }
    }
    // From the last node to the end of the path the last slope continues.
    float rest = end - path->depth[n - 1];
    for (int t = 0; t < PATH_TILE; t++) {
        float last = exponent[t] + sigma_t * path->slope[t] * rest;
        sum[t] += path->transmittance[n - 1][t] * rest *
                  mean_exp(before[t], exp_minus(last), exponent[t], last);
        sum[t] *= factor;
    }
}

PRT_INLINE uint32_t PRT_KERNEL(grid_of)(float r)
{
    return prt_log_index(r > 0 ? r : 0, EXTINCTION_SHIFT);
}

// out[j] = integral of B_j over [0, r], linear between the table's points.
PRT_INLINE void PRT_KERNEL(extinction_integral)(const struct extinction_table *table, int wide,
                                                float r, float *out)
{
    uint32_t b = PRT_KERNEL(grid_of)(r), i = b < table->base ? 0 : b - table->base;
    if (i > table->n_grid - 2) i = table->n_grid - 2;
    const float *lo = table->integral + (size_t)i * EXTINCTION_WIDE, *hi = lo + EXTINCTION_WIDE;
    float width = table->r[i + 1] - table->r[i], f = width > 0 ? (r - table->r[i]) / width : 0;
    f = f < 1 ? f : 1;
    if (b < table->base) { // the functions are constant below the first point
        f = r / table->r[0];
        for (int j = 0; j < wide; j++) out[j] = f * lo[j];
        return;
    }
    for (int j = 0; j < wide; j++) out[j] = lo[j] + f * (hi[j] - lo[j]);
}

// Integrals of every function of a radial basis over a tile, X07 eq 15: with s + s'(s)
// piecewise linear they are differences of the functions' running integrals. Without `rgb` out
// is [n_phase][n_radial][n] per direction; with it (X07: the light is fixed) the directions are
// summed into out [n_phase][n_radial][3]. wide: a constant, at least the number of functions.
PRT_INLINE void PRT_KERNEL(radial_sums)(const struct path_job *job, const struct path *path,
                                        uint32_t first, uint32_t m, int wide)
{
    const struct single_plan *plan = job->plan;
    const struct scratch *s = job->s;
    const float *rgb = job->rgb;
    float *out = job->out;
    const uint32_t n = job->n;
    const struct extinction_table *table = plan->extinction;
    const uint32_t all = job->n_radial ? job->n_radial : table->n_function;
    uint32_t K = plan->n_phase, J = table->n_function, points = path->n_point;
    enum { WIDE = EXTINCTION_WIDE };
    for (uint32_t t = 0; t < m; t++) {
        float sum[PATH_MAX_PHASE][WIDE], y[SINGLE_MAX_NODES][PATH_MAX_PHASE],
            mid[PATH_MAX_PHASE];
        float before[WIDE], after[WIDE], u = path->u[0][t];
        bool any = prt_path_node_sh(plan, s, path_direction(s, first + t), y);
        memset(sum, 0, K * sizeof *sum);
        if (any) PRT_KERNEL(extinction_integral)(table, wide, u, before);
        for (uint32_t i = 1; any && i <= points; i++) {
            // The last step continues with the last slope to the end of the path.
            bool last = i == points;
            float step = (last ? job->end : path->depth[i]) - path->depth[i - 1];
            if (step <= 0) break;
            float next = last ? fmaxf(u + path->slope[t] * step, 0) : path->u[i][t];
            float ft_v = 0.5f * (path->transmittance[i - 1][t] +
                                 path->transmittance[last ? i - 1 : i][t]);
            float least = fmaxf(least_slope * step, least_ratio * u);
            if (fabsf(next - u) < least) next = u + least;
            if (ft_v <= 0 && i + 1 < points &&
                path->transmittance[i + 1][t] <= 0) { // dark on both sides
                u = next, PRT_KERNEL(extinction_integral)(table, wide, u, before);
                continue;
            }
            PRT_KERNEL(extinction_integral)(table, wide, next, after);
            if (last) memcpy(mid, y[plan->n_node - 1], sizeof mid);
            else path_middle_sh(plan, path, i, y, mid);
            for (uint32_t k = 0; k < K; k++) {
                float w = ft_v * mid[k] * step / (next - u);
                for (int j = 0; j < wide; j++) sum[k][j] += w * (after[j] - before[j]);
            }
            memcpy(before, after, (size_t)wide * sizeof *before);
            u = next;
        }
        for (uint32_t k = 0; k < K; k++)
            for (uint32_t j = 0; j < J; j++) {
                const float *light = rgb ? rgb + (size_t)(first + t) * 3 : NULL;
                if (!rgb) out[((size_t)k * all + job->first + j) * n + first + t] = sum[k][j];
                for (int c = 0; rgb && any && c < 3; c++)
                    out[(k * J + j) * 3 + (uint32_t)c] += sum[k][j] * light[c];
            }
    }
}

static void PRT_KERNEL(integrate_radial)(const struct path_job *job, const struct path *path,
                                         uint32_t first, uint32_t m)
{
    if (job->plan->extinction->n_function <= EXTINCTION_WIDE / 2)
        PRT_KERNEL(radial_sums)(job, path, first, m, EXTINCTION_WIDE / 2);
    else PRT_KERNEL(radial_sums)(job, path, first, m, EXTINCTION_WIDE);
}

/* ---- rows ---- */

// Values of cells to texels: texel t has the value of its cell, of those from `first` on.
static void PRT_KERNEL(expand_cells)(const float *value, const uint32_t *cell, uint32_t first,
                                     uint32_t n, float *out)
{
    for (uint32_t t = 0; t < n; t++) out[t] = value[cell[t] - first];
}

// The largest of a component's coefficients among the entries that are kept.
static float PRT_KERNEL(largest)(const float *x, const float *sum, float limit, uint32_t n)
{
    float most[ROW_LANES] = {0}, all = 1e-30f;
    for (uint32_t k = 0; k < n; k += ROW_LANES)
        for (uint32_t i = 0; i < ROW_LANES; i++) {
            float own = sum[k + i] > limit ? fabsf(x[k + i]) : 0;
            most[i] = own > most[i] ? own : most[i];
        }
    for (uint32_t i = 0; i < ROW_LANES; i++) all = most[i] > all ? most[i] : all;
    return all;
}

// Energy of a component in the entries that are kept.
static float PRT_KERNEL(kept_energy)(const float *x, const float *sum, float limit, uint32_t n)
{
    float part[ROW_LANES] = {0}, all = 0;
    for (uint32_t k = 0; k < n; k += ROW_LANES)
        for (uint32_t i = 0; i < ROW_LANES; i++)
            part[i] += sum[k + i] > limit ? x[k + i] * x[k + i] : 0;
    for (uint32_t i = 0; i < ROW_LANES; i++) all += part[i];
    return all;
}

// The number of entries above a limit, where those whose share is above another count twice.
static uint32_t PRT_KERNEL(count_above)(const float *sum, float limit, const float *share,
                                        float above, uint32_t n)
{
    uint32_t part[ROW_LANES] = {0}, all = 0;
    for (uint32_t k = 0; k < n; k += ROW_LANES)
        for (uint32_t i = 0; i < ROW_LANES; i++)
            part[i] += sum[k + i] > limit ? 1u + (share[k + i] > above) : 0u;
    for (uint32_t i = 0; i < ROW_LANES; i++) all += part[i];
    return all;
}

// Sum of squared quantisation steps of the entries that are stored once: a step is the least
// power of two above the entry's share of 127.
static float PRT_KERNEL(squared_steps)(const float *sum, float limit, const float *share,
                                       float above, uint32_t n)
{
    float part[ROW_LANES] = {0}, all = 0;
    for (uint32_t k = 0; k < n; k += ROW_LANES)
        for (uint32_t i = 0; i < ROW_LANES; i++) {
            union {
                float value;
                uint32_t bits;
            } step = {.value = share[k + i] / 127};
            step.bits = (step.bits & 0x7f800000u) + 0x00800000u;
            bool once = sum[k + i] > limit && !(share[k + i] > above);
            part[i] += once ? step.value * step.value : 0;
        }
    for (uint32_t i = 0; i < ROW_LANES; i++) all += part[i];
    return all;
}

static void PRT_KERNEL(raise_share)(const float *x, float scale, float *share, uint32_t n)
{
    for (uint32_t k = 0; k < n; k++) {
        float own = fabsf(x[k]) * scale;
        share[k] = own > share[k] ? own : share[k];
    }
}

static const struct bake_loops PRT_KERNEL(loops) = {
    .light_texels = PRT_KERNEL(light_texels),
    .aim = PRT_KERNEL(aim),
    .refract = PRT_KERNEL(refract),
    .attenuate = PRT_KERNEL(attenuate),
    .steps = PRT_KERNEL(steps),
    .subdivide = PRT_KERNEL(subdivide),
    .integrate_isotropic = PRT_KERNEL(integrate_isotropic),
    .integrate_radial = PRT_KERNEL(integrate_radial),
    .expand_cells = PRT_KERNEL(expand_cells),
    .largest = PRT_KERNEL(largest),
    .kept_energy = PRT_KERNEL(kept_energy),
    .count_above = PRT_KERNEL(count_above),
    .squared_steps = PRT_KERNEL(squared_steps),
    .raise_share = PRT_KERNEL(raise_share)};
