// SPDX-License-Identifier: MIT
// prt bake: precomputes the transport of a model and writes a .prt.
#include "tool.h"
#include "prt/bake.h"
#include "prt/radial.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

// Default: joint without --material and without options of wavelet transport, else wavelet.
static enum prt_transport_kind engine_of(const struct options *o)
{
    bool sparse = o->coeffs || (o->storage && !strcmp(o->storage, "sparse"));
    if (!o->transport && !o->n_material && !sparse) return PRT_TRANSPORT_JOINT;
    if (o->transport && !strcmp(o->transport, "polynomial")) return PRT_TRANSPORT_POLYNOMIAL;
    if (o->transport && !strcmp(o->transport, "joint")) return PRT_TRANSPORT_JOINT;
    return PRT_TRANSPORT_WAVELET;
}

// Combinations that the check of a single value cannot see.
static int check_usage(const struct options *o, enum prt_transport_kind engine)
{
    bool sparse = o->storage && !strcmp(o->storage, "sparse");
    if (!o->out && !o->estimate) return usage_error(o, "-o OUT.prt is missing");
    if (!o->env && engine == PRT_TRANSPORT_POLYNOMIAL)
        return usage_error(o,
                           "--transport polynomial is baked under one light: it needs --env");
    if (o->checkpoint_room && !o->checkpoint)
        return usage_error(o, "--checkpoint-room is for --checkpoint");
    if (o->cache_room && !o->cache) return usage_error(o, "--cache-room is for --cache");
    if (sparse && engine != PRT_TRANSPORT_WAVELET)
        return usage_error(o, "--storage sparse is for --transport wavelet");
    if (o->basis && engine != PRT_TRANSPORT_POLYNOMIAL)
        return usage_error(o, "--basis is for --transport polynomial");
    if (o->draft && engine == PRT_TRANSPORT_POLYNOMIAL)
        return usage_error(o, "--draft is for --transport wavelet and joint");
    if (o->any_eta && engine != PRT_TRANSPORT_JOINT)
        return usage_error(o, "--any-eta is for --transport joint");
    if (o->any_eta && o->exit_planes)
        return usage_error(o, "--any-eta and --exit-planes exclude each other");
    if (o->any_eta && o->scattering && !strcmp(o->scattering, "walk"))
        return usage_error(o, "--any-eta is for --scattering dipole");
    if (sparse && (o->rank || o->basis_coeffs))
        return usage_error(o, "--rank and --basis-coeffs are for --storage factored");
    if (!sparse && o->coeffs) return usage_error(o, "--coeffs is for --storage sparse");
    uint64_t n = o->cube ? o->cube : 32;
    if (o->coeffs > 6 * n * n || o->basis_coeffs > 6 * n * n)
        return usage_error(o,
                           "a light of 6x%dx%d has %d coefficients: --coeffs and "
                           "--basis-coeffs must be in [1, %d]",
                           (int)n, (int)n, (int)(6 * n * n), (int)(6 * n * n));
    return EXIT_DONE;
}

static struct prt_bake_options bake_options(const struct options *o,
                                            enum prt_transport_kind engine)
{
    bool sparse = o->storage && !strcmp(o->storage, "sparse");
    return (struct prt_bake_options){
        .engine = engine,
        .storage = sparse ? PRT_STORAGE_SPARSE : PRT_STORAGE_FACTORED,
        .n_sample = (uint32_t)o->samples,
        .cube = o->cube,
        .n_coef = (uint32_t)o->coeffs,
        .rank = (uint32_t)o->rank,
        .n_basis_coef = (uint32_t)o->basis_coeffs,
        .n_phase = (uint32_t)o->phase_terms,
        .n_single = (uint32_t)o->single_points,
        .no_single = o->no_single,
        .exit_planes = o->exit_planes,
        .any_eta = o->any_eta,
        .draft = o->draft,
        .scattering = o->scattering && !strcmp(o->scattering, "walk") ? PRT_SCATTERING_WALK
                                                                      : PRT_SCATTERING_DIPOLE,
        .n_walk = (uint32_t)o->walks,
        .every_ray = o->every_ray,
        .max_error = o->max_error,
        .rotate_deg = o->rotate_deg,
        .basis = !o->basis || !strcmp(o->basis, "reduced") ? PRT_RADIAL_REDUCED
                 : !strcmp(o->basis, "hat")                ? PRT_RADIAL_HAT
                                                           : PRT_RADIAL_POLYNOMIAL,
        .seed = o->seed,
        .shard = o->shard,
        .n_shard = o->n_shard,
        .checkpoint = o->checkpoint,
        .checkpoint_room = o->checkpoint_room,
        .cache = o->cache,
        .cache_room = o->cache_room,
    };
}

// The settings that the .prt records: only values that are the same for equal bakes.
static char *provenance(const struct options *o)
{
    const char *slash = strrchr(o->input[0], '/'), *env;
    cJSON *root = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "model", slash ? slash + 1 : o->input[0]);
    if (o->size_mm > 0) cJSON_AddNumberToObject(root, "size_mm", o->size_mm);
    if (o->mm_per_unit > 0) cJSON_AddNumberToObject(root, "mm_per_unit", o->mm_per_unit);
    if (o->up && !strcmp(o->up, "z")) cJSON_AddStringToObject(root, "up", o->up);
    if (o->flip_v) cJSON_AddTrueToObject(root, "flip_v");
    if (o->env) {
        env = strrchr(o->env, '/');
        cJSON_AddStringToObject(root, "env", env ? env + 1 : o->env);
        if (o->rotate_deg != 0)
            cJSON_AddNumberToObject(root, "rotate_deg", (double)o->rotate_deg);
    }
    char *text = cJSON_PrintUnformatted(root);
    cJSON_Delete(root);
    return text;
}

static double number_of(const cJSON *object, const char *term, const char *light)
{
    const cJSON *item =
        cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(object, term), light);
    return cJSON_IsNumber(item) ? item->valuedouble : -1;
}

static void print_error(const char *words, double error)
{
    if (error >= 0) printf("%s %.2g %%", words, 100 * error);
}

// The measured errors in words, under each of the lights they were measured with.
static void report_errors(const char *errors)
{
    static const char *const light[][2] = {{"sky", "an even sky"},
                                           {"boxes", "three soft boxes"},
                                           {"sun", "a small sun"},
                                           {"own", "the bake's own light"}};
    cJSON *root = errors ? cJSON_Parse(errors) : NULL;
    for (size_t i = 0; i < sizeof light / sizeof *light; i++) {
        double multiple = number_of(root, "multiple", light[i][0]);
        if (multiple < 0) continue;
        printf("error under %s:", light[i][1]);
        print_error(" multiple scattering", multiple);
        print_error(", unscattered", number_of(root, "unscattered", light[i][0]));
        print_error(", single", number_of(root, "single", light[i][0]));
        print_error(", together", number_of(root, "together", light[i][0]));
        print_error("; with the single scattering that a draft leaves out",
                    number_of(root, "total", light[i][0]));
        putchar('\n');
    }
    const cJSON *noise = cJSON_GetObjectItemCaseSensitive(root, "walk_noise");
    if (cJSON_GetObjectItemCaseSensitive(root, "reference_walks"))
        puts("these are against walks of the reference, whose noise is taken out");
    if (cJSON_IsNumber(noise))
        printf("the bake's own walks leave a noise of %.2g %% under random lights\n",
               100 * noise->valuedouble);
    const double sky = number_of(root, "dipole", "sky");
    const cJSON *dipole = cJSON_GetObjectItemCaseSensitive(root, "dipole");
    const cJSON *dark = cJSON_GetObjectItemCaseSensitive(dipole, "darkest");
    const cJSON *bright = cJSON_GetObjectItemCaseSensitive(dipole, "brightest");
    if (sky >= 0 && cJSON_IsNumber(dark) && cJSON_IsNumber(bright))
        printf("against walks the dipole%s errs by %.2g %% under the even sky; at one vertex "
               "in fifty by more than %+.2g %%, at one by more than %+.2g %% (prt image --term "
               "difference shows where)\n",
               cJSON_GetObjectItemCaseSensitive(root, "reference_walks") ? "" : " of this bake",
               100 * sky, 100 * dark->valuedouble, 100 * bright->valuedouble);
    double view = number_of(root, "single_toward_eyes", "worst");
    if (view >= 0) {
        print_error("single scattering towards an eye, the mean of four around the model:",
                    view);
        putchar('\n');
    }
    cJSON_Delete(root);
}

static void add_profile(cJSON *root, const struct prt_bake_profile *p)
{
    cJSON *profile = cJSON_AddObjectToObject(root, "profile");
    cJSON *work = cJSON_AddArrayToObject(profile, "work");
    for (uint32_t i = 0; i < p->n_work; i++) {
        cJSON *item = cJSON_CreateObject();
        cJSON_AddStringToObject(item, "name", p->work[i].name);
        cJSON_AddNumberToObject(item, "cpu_seconds", p->work[i].cpu_seconds);
        if (p->work[i].rays) cJSON_AddNumberToObject(item, "rays", (double)p->work[i].rays);
        if (p->work[i].flop > 0) cJSON_AddNumberToObject(item, "flop", p->work[i].flop);
        cJSON_AddItemToArray(work, item);
    }
    if (p->cached) cJSON_AddNumberToObject(profile, "irradiance_reused", p->reused);
    cJSON_AddNumberToObject(profile, "threads", p->n_thread);
    cJSON_AddNumberToObject(profile, "machine_rays_s", p->rays_s);
    cJSON_AddNumberToObject(profile, "machine_flop_s", p->flop_s);
}

// A rate in millions or billions, or a dash.
static void print_rate(double done, double seconds, double unit)
{
    if (done > 0 && seconds > 0) printf("%12.1f", done / seconds / unit);
    else printf("%12s", "-");
}

// One line for each kind of work, and the machine's own rates for the same number of threads.
static void print_profile(const struct prt_bake_profile *p)
{
    double all = 0;
    for (uint32_t i = 0; i < p->n_work; i++) all += p->work[i].cpu_seconds;
    printf("%-12s%10s%8s%12s%12s\n", "work", "CPU s", "share", "Mray/s", "GFLOP/s");
    for (uint32_t i = 0; i < p->n_work; i++) {
        const struct prt_bake_work *w = &p->work[i];
        double s = w->cpu_seconds / p->n_thread; // rates of all threads together
        printf("%-12s%10.2f%7.1f%%", w->name, w->cpu_seconds, 100 * w->cpu_seconds / all);
        print_rate((double)w->rays, s, 1e6);
        print_rate(w->flop, s, 1e9);
        putchar('\n');
    }
    printf("%-12s%10.2f%8s%12.1f%12.1f\n", "machine", p->n_thread * p->seconds, "",
           p->rays_s * 1e-6, p->flop_s * 1e-9);
    if (p->cached)
        printf("%.2f %% of the directions of irradiance came from --cache\n", 100 * p->reused);
}

static int report(struct tool *tool, double seconds, const struct prt_bake_profile *profile)
{
    const struct options *o = &tool->opt;
    struct prt_file *file;
    int status = prt_file_open(&tool->ctx, o->out, PRT_FILE_CHECK_HEADERS, &file);
    if (status) return tool_exit(tool, status);
    const struct prt_transport *t = prt_file_transport(file);
    double bytes = (double)prt_file_bytes(file), a_vertex = 0;
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        uint64_t u_bytes, row_bytes;
        prt_tensor_bytes(&t->tensor[i], &u_bytes, &row_bytes);
        a_vertex += (double)(u_bytes + row_bytes) / t->mesh.n_vertex;
    }
    if (o->json) {
        cJSON *root = cJSON_CreateObject();
        cJSON_AddStringToObject(root, "out", o->out);
        cJSON_AddNumberToObject(root, "seconds", seconds);
        cJSON_AddNumberToObject(root, "bytes", bytes);
        cJSON_AddNumberToObject(root, "vertices", t->mesh.n_vertex);
        cJSON_AddNumberToObject(root, "bytes_per_vertex", a_vertex);
        cJSON *errors = t->errors ? cJSON_Parse(t->errors) : NULL;
        if (errors) cJSON_AddItemToObject(root, "errors", errors);
        if (o->profile) add_profile(root, profile);
        char *text = cJSON_PrintUnformatted(root);
        puts(text ? text : "{}");
        free(text);
        cJSON_Delete(root);
    } else if (!o->quiet) {
        printf("%s: %u vertices, %.1f MB, %.0f bytes of transport a vertex, baked in %.1f s\n",
               o->out, t->mesh.n_vertex, bytes * 1e-6, a_vertex, seconds);
        report_errors(t->errors);
        if (o->profile) print_profile(profile);
    }
    prt_file_close(file);
    return EXIT_DONE;
}

// Reports one finished part and the number of missing parts.
static int report_part(const struct options *o, double seconds, uint32_t missing)
{
    bool elsewhere = missing == UINT32_MAX;
    if (o->json) {
        cJSON *root = cJSON_CreateObject();
        cJSON_AddStringToObject(root, "out", o->out);
        cJSON_AddNumberToObject(root, "shard", o->shard);
        cJSON_AddNumberToObject(root, "shards", o->n_shard);
        cJSON_AddNumberToObject(root, "parts_missing", elsewhere ? 0 : missing);
        cJSON_AddNumberToObject(root, "seconds", seconds);
        char *text = cJSON_PrintUnformatted(root);
        puts(text ? text : "{}");
        free(text);
        cJSON_Delete(root);
    } else if (!o->quiet) {
        printf("%s: shard %u/%u done in %.1f s, ", o->out, o->shard, o->n_shard, seconds);
        if (elsewhere) puts("another process assembles the parts");
        else printf("%u of %u to come\n", missing, o->n_shard);
    }
    return EXIT_DONE;
}

// Has the bake make do with --memory, at most with what is free, or with half of that.
static uint64_t usable_memory(const struct options *o)
{
    uint64_t page = (uint64_t)sysconf(_SC_PAGESIZE);
    uint64_t free_bytes = (uint64_t)sysconf(_SC_AVPHYS_PAGES) * page;
    if (!o->memory) return free_bytes / 2;
    return o->memory < free_bytes ? o->memory : free_bytes;
}

// A sanitizer needs memory of its own. `instrumented` bytes hold freed blocks that it keeps;
// with its shadow memory a bake takes `shadowed` times as much (the thread sanitizer's shadow
// is about four times the memory in use).
#if defined(__SANITIZE_THREAD__)
static const uint64_t instrumented = UINT64_C(2) << 30, shadowed = 6;
#elif defined(__SANITIZE_ADDRESS__)
static const uint64_t instrumented = UINT64_C(2) << 30, shadowed = 1;
#else
static const uint64_t instrumented = 0, shadowed = 1;
#endif

// Watches the memory of this process: --memory, or 1.5 times the estimate (chosen, not
// measured).
static int limit_memory(struct tool *tool, uint64_t estimate)
{
    const struct options *o = &tool->opt;
    uint64_t machine = (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE);
    uint64_t most = o->memory ? o->memory : machine;
    if (o->memory_set && estimate > most)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_LIMIT,
                                        "%s: this bake is estimated to need %llu MB of memory, "
                                        "%s %llu MB (prt's --memory, relightd's "
                                        "--bake-memory); ask for fewer samples or a smaller "
                                        "cube",
                                        o->input[0], (unsigned long long)(estimate >> 20),
                                        o->memory ? "the limit is" : "the machine has",
                                        (unsigned long long)(most >> 20)));
    if (!o->memory_set) return memory_watch(tool, 0);
    return memory_watch(tool, o->memory ? o->memory
                                        : (estimate + estimate / 2) * shadowed + instrumented);
}

static void note_etas(const struct tool *tool, const struct prt_media *media)
{
    double eta[PRT_MEDIA_MAX];
    char text[PRT_MEDIA_MAX * 12] = "";
    uint32_t n = prt_media_etas(media, eta);
    for (uint32_t i = 0; i < n; i++) {
        size_t at = strlen(text);
        snprintf(text + at, sizeof text - at, "%s%g", i ? ", " : "", eta[i]);
    }
    prt_log(&tool->ctx, PRT_LOG_NOTE, "no --material: baked for eta %s", text);
}

static int print_estimate(struct tool *tool, const struct prt_mesh *mesh,
                          const struct prt_bake_options *options, uint64_t bytes)
{
    double cpu_s, once_s;
    int status = prt_bake_seconds(&tool->ctx, mesh, options, &cpu_s, &once_s);
    if (status) return tool_exit(tool, status);
    if (tool->opt.json)
        printf("{\"memory_bytes\":%llu,\"cpu_seconds\":%.3g,\"cpu_seconds_once\":%.3g}\n",
               (unsigned long long)bytes, cpu_s, once_s);
    else printf("%llu %.0f %.0f\n", (unsigned long long)bytes, ceil(cpu_s), ceil(once_s));
    return EXIT_DONE;
}

// A draft is by the dipole. Its errors are against what the bake will take that replaces it.
static int choose_for_draft(struct tool *tool, const struct prt_mesh *mesh,
                            struct prt_bake_options *options)
{
    char why[PRT_BAKE_WHY];
    struct prt_bake_options bake = *options;
    enum prt_scattering scattering = options->scattering;
    int status = PRT_OK;
    bake.draft = false;
    if (!tool->opt.scattering)
        status = prt_bake_choose_scattering(&tool->ctx, mesh, &bake, &scattering, why);
    options->scattering = PRT_SCATTERING_DIPOLE;
    options->walks_follow =
        scattering == PRT_SCATTERING_WALK && options->engine == PRT_TRANSPORT_WAVELET;
    if (!tool->opt.scattering || options->walks_follow)
        prt_log(&tool->ctx, PRT_LOG_NOTE, "--scattering dipole: a draft is to be quick%s",
                options->walks_follow ? ", scaled to walks, by which the bake is" : "");
    return tool_exit(tool, status);
}

// Without --scattering the better one, with a note.
static int choose_scattering(struct tool *tool, const struct prt_mesh *mesh,
                             struct prt_bake_options *options)
{
    char why[PRT_BAKE_WHY];
    if (options->draft) return choose_for_draft(tool, mesh, options);
    if (tool->opt.scattering) return EXIT_DONE;
    int status =
        prt_bake_choose_scattering(&tool->ctx, mesh, options, &options->scattering, why);
    if (!status)
        prt_log(&tool->ctx, PRT_LOG_NOTE, "--scattering %s: %s",
                options->scattering == PRT_SCATTERING_WALK ? "walk" : "dipole", why);
    return tool_exit(tool, status);
}

int run_bake(struct tool *tool)
{
    const struct options *o = &tool->opt;
    enum prt_transport_kind engine = engine_of(o);
    struct source source = {0};
    struct prt_env *env = NULL;
    char *settings = NULL;
    struct prt_bake_profile profile;
    uint32_t missing = 0;
    double started = prt_time_s();
    int exit_status = check_usage(o, engine);
    if (exit_status) return exit_status;
    if (!o->estimate && (exit_status = check_writable(tool, o->out))) return exit_status;
    if (access(o->input[0], R_OK) == 0 && prt_file_probe(o->input[0]))
        return usage_error(o, "%s is a .prt already: bake takes a model", o->input[0]);
    struct prt_bake_options options = bake_options(o, engine);
    // Of a joint bake only eta is used; the material stays free.
    const bool fixed = engine == PRT_TRANSPORT_WAVELET;
    if ((exit_status =
             source_open(tool, o->input[0], fixed ? NULL : prt_material_preset(0), &source)))
        return exit_status;
    if (!source.media_given && !fixed && !options.any_eta) note_etas(tool, &source.media);
    if (o->env && engine == PRT_TRANSPORT_POLYNOMIAL) {
        exit_status = tool_exit(tool, tool_env_load(tool, o->env, &env));
        if (exit_status) goto done;
    } else if (o->env) {
        prt_log(&tool->ctx, PRT_LOG_WARNING,
                "--env is for --transport polynomial; this bake serves every light");
    }
    options.media = source.media;
    options.env = env;
    options.memory = usable_memory(o);
    uint64_t bytes = 0;
    if ((exit_status = choose_scattering(tool, source.mesh, &options))) goto done;
    if (options.walks_follow || options.scattering == PRT_SCATTERING_WALK)
        prt_progress(&tool->ctx, "by walks", 0); // programs plan their time
    exit_status = tool_exit(tool, prt_bake_memory(&tool->ctx, source.mesh, &options, &bytes));
    if (!exit_status && o->estimate)
        exit_status = print_estimate(tool, source.mesh, &options, bytes);
    if (!exit_status && !o->estimate) exit_status = limit_memory(tool, bytes);
    if (exit_status || o->estimate) goto done;
    settings = provenance(o);
    options.settings_json = settings;
    options.parts_missing = &missing;
    options.profile = o->profile ? &profile : NULL;
    exit_status = memory_watch_end(prt_bake(&tool->ctx, source.mesh, &options, o->out));
    double seconds = prt_time_s() - started;
    if (!exit_status)
        exit_status =
            missing ? report_part(o, seconds, missing) : report(tool, seconds, &profile);
done:
    free(settings);
    if (env) prt_env_destroy(env);
    source_close(&source);
    return exit_status;
}
