// SPDX-License-Identifier: MIT
// relight events: what happens in the daemon; relight download: an upload comes back.
#include "cli.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

static cJSON *event_json(const struct relight_event *e)
{
    cJSON *json = cJSON_CreateObject();
    const struct {
        const char *word, *text;
    } texts[] = {{"model", e->model},    {"before", e->before}, {"name", e->name},
                 {"env", e->env},        {"job", e->job},       {"stage", e->stage},
                 {"failure", e->failure}};
    cJSON_AddStringToObject(json, "event", relight_event_name(e->kind));
    cJSON_AddNumberToObject(json, "kind", e->kind);
    if (e->time_us) cJSON_AddNumberToObject(json, "time_us", (double)e->time_us);
    if (e->lost) cJSON_AddBoolToObject(json, "lost", 1);
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        if (*texts[i].text) cJSON_AddStringToObject(json, texts[i].word, texts[i].text);
    if (*e->job) {
        cJSON_AddStringToObject(json, "state", job_name(e->job_state));
        cJSON_AddNumberToObject(json, "fraction", e->fraction);
    } else if (*e->model) {
        cJSON_AddStringToObject(json, "state", relight_model_state_name(e->state));
        cJSON_AddNumberToObject(json, "generation", (double)e->generation);
    }
    return json;
}

static void print_event(const struct relight_event *e)
{
    char when[16] = "";
    time_t seconds = (time_t)(e->time_us / 1000000);
    struct tm local;
    if (localtime_r(&seconds, &local)) strftime(when, sizeof when, "%H:%M:%S", &local);
    printf("%s  %s", when, relight_event_name(e->kind));
    if (*e->model) printf("  %s", escape(e->model).text);
    if (*e->env) printf("  %s", escape(e->env).text);
    if (*e->name) printf("  %s", escape(e->name).text);
    if (*e->job)
        printf("  %s %s %.0f%%", escape(e->job).text, job_name(e->job_state),
               100 * e->fraction);
    else if (*e->model) printf("  %s", relight_model_state_name(e->state));
    if (*e->failure) printf("  %s", escape(e->failure).text);
    putchar('\n');
}

static int tell(void *user, const struct relight_event *e)
{
    const struct options *options = user;
    if (e->lost && !options->json)
        puts("          events were lost: `relight models` lists what is there");
    if (e->kind == RELIGHT_EVENT_NONE && !(e->lost && options->json)) return 0;
    if (options->json) print_json(event_json(e));
    else print_event(e);
    fflush(stdout);
    return ferror(stdout) != 0;
}

static const double past_s = 0.5; // events of the past come at once

int run_events(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_cursor cursor = {"", 0}; // from now on
    if (!options->follow)
        snprintf(cursor.run, sizeof cursor.run, "%s", relight_server(client)->run);
    if (relight_events(client, &cursor, options->follow ? -1 : past_s, tell, options, &error))
        return report_error(options, &error);
    return EXIT_DONE;
}

int run_download(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    uint64_t size;
    if (!options->output) return report_usage(options, "-o FILE is missing");
    if (relight_download(client, options->target, options->output, progress_bar, NULL, &size,
                         &error))
        return report_error(options, &error);
    progress_clear();
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "bytes", (double)size);
        print_json(json);
    } else {
        printf("%llu bytes\n", (unsigned long long)size);
    }
    return EXIT_DONE;
}
