// SPDX-License-Identifier: MIT
// MATERIAL: the numbers of a medium, in the form of other programs as well, also of one that a
// file of another program describes.
#include "net/dispatch.h"
#include "jobs/decode_helper.h"
#include "net/request.h"
#include "net/request_wait.h"
#include "prt/medium.h"
#include "relight.pb-c.h"
#include "render/shared/materials.h"
#include "store/blobs.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void put(Relight__Vec3 *out, const float x[3])
{
    relight__vec3__init(out);
    out->x = x[0];
    out->y = x[1];
    out->z = x[2];
}

// warnings: one a line.
static void answer(struct request *request, const struct prt_material *m, char *json,
                   const char *warnings)
{
    Relight__MaterialAnswer out = RELIGHT__MATERIAL_ANSWER__INIT;
    char *line[32], *copy = strdup(warnings), *save = NULL;
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
    for (char *one = copy ? strtok_r(copy, "\n", &save) : NULL; one && out.n_warnings < 32;
         one = strtok_r(NULL, "\n", &save))
        line[out.n_warnings++] = one;
    out.warnings = line;
    out.json = json;
    out.profile = m->n_point != 0;
    out.reflectance = &reflectance;
    out.mean_free_path = &free_path;
    out.sigma_t = &sigma_t;
    out.g = &g;
    out.eta = m->eta;
    out.roughness = m->roughness;
    request_answer(request, &out.base, NULL);
    free(copy);
}

// ---- a file of another program

struct importing {
    struct request_wait wait;
    struct blob_waiter blob_waiter;
    struct server *server;
    char hash[BLOB_HASH + 1], material[64];
};

static void imported(void *user, const char *json, int status, const char *error,
                     const char *warnings)
{
    struct importing *i = user;
    struct request *request = request_resume(&i->wait);
    struct prt_material *m = json && request ? malloc(sizeof *m) : NULL;
    struct prt_context quiet;
    prt_context_init(&quiet);
    quiet.log = prt_log_none;
    if (request && !json) request_fail(request, error_of_status(status), "%s", error);
    else if (request && (!m || prt_material_parse(&quiet, "material", json, strlen(json), m)))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL, "the material is damaged");
    else if (request) answer(request, m, (char *)json, warnings);
    free(m);
    free(i);
}

static void checked(struct blob_waiter *waiter)
{
    struct importing *i =
        (struct importing *)((char *)waiter - offsetof(struct importing, blob_waiter));
    char path[PATH_MAX], name[24];
    snprintf(name, sizeof name, "material %.12s", i->hash);
    if (blobs_has(i->server->blobs, i->hash)) {
        blobs_path(i->server->blobs, i->hash, path, sizeof path);
        decoder_material(i->server->decoder, path, name, i->material, imported, i);
    } else {
        imported(i, NULL, PRT_IO, "its upload was damaged on the daemon's disk: send it again",
                 "");
    }
}

static void import(struct request *request, const Relight__MaterialRequest *in)
{
    struct blobs *blobs = request->server->blobs;
    struct importing *i = NULL;
    if (!relight_hash_valid(in->blob) || !blobs_has(blobs, in->blob))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "blob: it was not uploaded");
    else if (strlen(in->material) >= sizeof i->material)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "material: the name has more than 63 bytes");
    else if (!(i = calloc(1, sizeof *i)))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    if (!i) return;
    i->server = request->server;
    snprintf(i->hash, sizeof i->hash, "%s", in->blob);
    snprintf(i->material, sizeof i->material, "%s", in->material);
    request_park(request, &i->wait);
    i->blob_waiter.wake = checked;
    blobs_touch(blobs, i->hash);
    blobs_check(blobs, i->hash, &i->blob_waiter);
}

void op_material(struct request *request)
{
    const Relight__MaterialRequest *in = (const Relight__MaterialRequest *)request->message;
    struct prt_material *m = malloc(sizeof *m);
    char *json = malloc(PRT_MATERIAL_TEXT), error[300];
    bool preset;
    if (in->blob[0]) {
        free(m);
        free(json);
        import(request, in);
        return;
    }
    if (!m || !json)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    else if (material_of_request(request, in->material, m, &preset, error))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "%s", error);
    else if (prt_material_print(m, json, PRT_MATERIAL_TEXT) < 0)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_INTERNAL, "it can not be printed");
    else answer(request, m, json, "");
    free(m);
    free(json);
}
