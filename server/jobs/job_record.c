// SPDX-License-Identifier: MIT
// A job as JSON.
#include "jobs/job_record.h"

#include "relight.pb-c.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

char *job_record_print(const struct job_record *r)
{
    cJSON *json = cJSON_CreateObject();
    char order[24];
    snprintf(order, sizeof order, "%llu", (unsigned long long)r->order);
    cJSON_AddStringToObject(json, "id", r->id);
    cJSON_AddStringToObject(json, "model", r->model);
    cJSON_AddStringToObject(json, "owner", r->owner);
    cJSON_AddStringToObject(json, "folder", r->folder);
    cJSON_AddStringToObject(json, "order", order);
    cJSON_AddNumberToObject(json, "state", r->state);
    cJSON_AddStringToObject(json, "stage", r->stage);
    cJSON_AddNumberToObject(json, "fraction", r->fraction);
    cJSON_AddNumberToObject(json, "elapsed_s", r->elapsed_s);
    cJSON_AddStringToObject(json, "error", r->error);
    cJSON_AddStringToObject(json, "warnings", r->warnings);
    cJSON_AddStringToObject(json, "recipe", r->recipe ? r->recipe : "");
    char *text = cJSON_Print(json);
    cJSON_Delete(json);
    return text;
}

static bool take(const cJSON *json, const char *key, char *out, size_t n)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    if (!text || strlen(text) >= n) return false;
    strcpy(out, text);
    return true;
}

static double number(const cJSON *json, const char *key)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, key);
    return cJSON_IsNumber(item) && isfinite(item->valuedouble) ? item->valuedouble : 0;
}

// Whether the name is that of a folder right below DATA/work, which is removed with the job.
static bool is_folder(const char *name)
{
    return name[0] && name[0] != '.' && !strchr(name, '/');
}

bool job_record_parse(const char *text, struct job_record *r)
{
    char order[24] = "";
    cJSON *json = cJSON_Parse(text);
    const char *recipe = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, "recipe"));
    memset(r, 0, sizeof *r);
    bool ok = take(json, "id", r->id, sizeof r->id) && r->id[0] &&
              take(json, "model", r->model, sizeof r->model) &&
              take(json, "owner", r->owner, sizeof r->owner) &&
              take(json, "folder", r->folder, sizeof r->folder) && is_folder(r->folder) &&
              take(json, "order", order, sizeof order) &&
              take(json, "stage", r->stage, sizeof r->stage) &&
              take(json, "error", r->error, sizeof r->error) &&
              take(json, "warnings", r->warnings, sizeof r->warnings);
    r->order = strtoull(order, NULL, 10);
    r->state = (int)number(json, "state");
    r->fraction = number(json, "fraction");
    r->elapsed_s = number(json, "elapsed_s");
    ok = ok && r->state >= RELIGHT__JOB_STATE__JOB_QUEUED &&
         r->state <= RELIGHT__JOB_STATE__JOB_CANCELLED;
    r->recipe = ok ? strdup(recipe ? recipe : "") : NULL;
    cJSON_Delete(json);
    return ok && r->recipe;
}
