// SPDX-License-Identifier: MIT
// MATERIAL: the numbers of a medium, in the form of other programs as well.
#include "net/dispatch.h"
#include "net/request.h"
#include "prt/medium.h"
#include "relight.pb-c.h"
#include "render/shared/materials.h"

#include <stdlib.h>

static void put(Relight__Vec3 *out, const float x[3])
{
    relight__vec3__init(out);
    out->x = x[0];
    out->y = x[1];
    out->z = x[2];
}

static void answer(struct request *request, const struct prt_material *m, char *json)
{
    Relight__MaterialAnswer out = RELIGHT__MATERIAL_ANSWER__INIT;
    Relight__Vec3 reflectance, free_path, sigma_t, g;
    struct prt_diffusion d[3];
    float rho[3], path[3], t[3];
    prt_material_dipoles(m, d);
    for (int c = 0; c < 3; c++) {
        rho[c] = (float)(m->n_point ? prt_diffusion_tail(&d[c], 0) : d[c].rho_d);
        path[c] = 1 / (m->sigma_s_prime[c] + m->sigma_a[c]);
        t[c] = m->sigma_s_prime[c] / (1 - m->g[c]) + m->sigma_a[c];
    }
    put(&reflectance, rho);
    put(&free_path, path);
    put(&sigma_t, t);
    put(&g, m->g);
    out.json = json;
    out.profile = m->n_point != 0;
    out.reflectance = &reflectance;
    out.mean_free_path = &free_path;
    out.sigma_t = &sigma_t;
    out.g = &g;
    out.eta = m->eta;
    out.roughness = m->roughness;
    request_answer(request, &out.base, NULL);
}

void op_material(struct request *request)
{
    const Relight__MaterialRequest *in = (const Relight__MaterialRequest *)request->message;
    struct prt_material *m = malloc(sizeof *m);
    char *json = malloc(PRT_MATERIAL_TEXT), error[300];
    bool preset;
    if (!m || !json)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    else if (material_of_request(request, in->material, m, &preset, error))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "%s", error);
    else if (prt_material_print(m, json, PRT_MATERIAL_TEXT) < 0)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL, "it can not be printed");
    else answer(request, m, json);
    free(m);
    free(json);
}
