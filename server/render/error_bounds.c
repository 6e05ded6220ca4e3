// SPDX-License-Identifier: MIT
// Error bounds of baked transport: the bake's measured errors for a term, and the error of
// projecting a material on the bake's bases. Relative RMS errors.
#include "render/walk.h"

#include <math.h>

// Radiance that leaves a half-space under uniform light, without the outgoing Fresnel factor,
// RMS over channels. Multiple scattering: rho_d over the exit's divisor. Single scattering:
// 0.2046 of the albedo for isotropic scattering, the mean over the cosine of albedo/2 [1 - mu
// ln((1 + mu) / mu)].
static void half_space_radiance(const struct prt_material *m, double *multiple, double *single)
{
    struct prt_diffusion dipole[3];
    prt_material_dipoles(m, dipole);
    *multiple = *single = 0;
    for (int c = 0; c < 3; c++) {
        double s = (double)m->sigma_s_prime[c] / (1 - (double)m->g[c]);
        double one = m->profile ? 0 : 0.2046 * s / (s + (double)m->sigma_a[c]);
        double many = prt_diffusion_tail(&dipole[c], 0);
        *multiple += many * many / 3;
        *single += one * one / 3;
    }
    *multiple = sqrt(*multiple) / prt_exit_divisor((double)m->eta, PRT_EXIT_NORMALISED);
    *single = sqrt(*single);
}

// Error of single scattering: measured along -n_o, or towards eyes where the answer has a view.
static float single_error(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    bool view = r->spec.picture || r->spec.has_eye;
    return view ? fmaxf(f->error_single, f->error_view) : f->error_single;
}

// Error of the total of a draft without single scattering S: as measured of the bake's own
// medium. For another one at least that of multiple scattering M, and the share of S in M + S,
// for half-spaces.
static float draft_error(const struct render *r, const struct prt_media *media)
{
    const struct model_facts *f = &r->model->facts;
    double error = (double)f->error_multiple, worst = fmax(error, (double)f->error_total);
    for (uint32_t i = 0; r->spec.has_material && i < media->n; i++) {
        double multiple, single;
        half_space_radiance(&media->medium[i], &multiple, &single);
        worst = fmax(worst, (error * multiple + single) / fmax(multiple + single, 1e-30));
    }
    return (float)worst;
}

// The error of the sum M + S of multiple and single scattering: |e_m + e_s| <= |e_m| + |e_s|,
// and as no radiance is negative |M + S|^2 >= |M|^2 + |S|^2. Never more than the larger of the
// two relative errors, which is the bound where M and S are proportional.
static float total_error(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    const struct prt_media *media = render_media(r);
    double larger = fmax((double)f->error_multiple, (double)single_error(r)), worst = 0;
    if (r->model->single_follows && !(f->error_single > 0)) return draft_error(r, media);
    if (f->error_total > 0 && !r->model->file) return f->error_total;
    if (!(f->error_single > 0)) return f->error_multiple; // no single scattering was baked
    for (uint32_t i = 0; i < media->n; i++) {
        double multiple, single;
        half_space_radiance(&media->medium[i], &multiple, &single);
        double sum = (double)f->error_multiple * multiple + (double)single_error(r) * single;
        worst = fmax(worst, sum / fmax(hypot(multiple, single), 1e-30));
    }
    return (float)fmin(larger, worst);
}

float bake_error(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    switch (r->spec.term) {
    case RELIGHT__TERM__TERM_IRRADIANCE:
        return 0; // traced, not baked
    case RELIGHT__TERM__TERM_MULTIPLE:
        return f->error_multiple;
    case RELIGHT__TERM__TERM_SINGLE:
        return single_error(r);
    default:
        return total_error(r);
    }
}

float material_error(const struct render *r)
{
    float error = 0;
    for (unsigned i = 0; i < render_n_values(&r->spec); i++) {
        const struct vertex_values *v = r->vertex_values[i].entry->value;
        error = fmaxf(error, v->material_error);
    }
    return error;
}
