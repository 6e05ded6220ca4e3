// SPDX-License-Identifier: MIT
// relight token: create, list and revoke the tokens of a daemon. relight sign: links by a
// token.
#include "cli.h"

#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { MOST_SCOPES = 8 };

static void print_day(char out[32], uint64_t seconds)
{
    time_t t = (time_t)seconds;
    struct tm when;
    if (seconds) strftime(out, 32, "%Y-%m-%d %H:%M", localtime_r(&t, &when));
    else snprintf(out, 32, "never");
}

// The words of --scope; they point into `text`, which is cut.
static size_t split_scopes(char *text, const char *out[MOST_SCOPES])
{
    size_t n = 0;
    char *save = NULL;
    for (char *w = strtok_r(text, ", ", &save); w && n < MOST_SCOPES;
         w = strtok_r(NULL, ", ", &save))
        out[n++] = w;
    return n;
}

static int create(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    const char *scope[MOST_SCOPES];
    char words[256], secret[RELIGHT_SECRET];
    struct relight_token_order order = options->token_order;
    if (!order.name) return report_usage(options, "create: --name is missing");
    if (!options->scopes)
        return report_usage(options, "create: --scope is missing: view, edit, upload, admin");
    snprintf(words, sizeof words, "%s", options->scopes);
    order.scope = scope;
    order.n_scope = split_scopes(words, scope);
    if (relight_token_create(client, &order, secret, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "name", order.name);
        cJSON_AddStringToObject(json, "token", secret);
        print_json(json);
        return EXIT_DONE;
    }
    printf("%s\n", secret);
    fprintf(stderr,
            "relight: this is the only time that the token is shown. Clients send it with "
            "RELIGHT_TOKEN or --token.\n");
    return EXIT_DONE;
}

static const struct {
    const char *word;
    size_t at;
} quota_words[] = {
    {"connections", offsetof(struct relight_quotas, connections)},
    {"requests", offsetof(struct relight_quotas, requests)},
    {"views", offsetof(struct relight_quotas, views)},
    {"memory", offsetof(struct relight_quotas, memory)},
    {"output", offsetof(struct relight_quotas, output)},
    {"bakes", offsetof(struct relight_quotas, bakes)},
    {"uploads", offsetof(struct relight_quotas, uploads)},
    {"models", offsetof(struct relight_quotas, models)},
    {"disk", offsetof(struct relight_quotas, disk)},
};
enum { N_QUOTA = sizeof quota_words / sizeof *quota_words };

static uint64_t quota(const struct relight_token *t, int i)
{
    return *(const uint64_t *)((const char *)&t->quotas + quota_words[i].at);
}

static cJSON *token_json(const struct relight_token *t)
{
    cJSON *json = cJSON_CreateObject(), *scopes, *quotas;
    cJSON_AddStringToObject(json, "name", t->name);
    scopes = cJSON_AddArrayToObject(json, "scopes");
    for (size_t i = 0; i < t->n_scope; i++)
        cJSON_AddItemToArray(scopes, cJSON_CreateString(t->scope[i]));
    cJSON_AddNumberToObject(json, "created_s", (double)t->created_s);
    cJSON_AddNumberToObject(json, "expires_s", (double)t->expires_s);
    cJSON_AddStringToObject(json, "by", t->by);
    cJSON_AddNumberToObject(json, "connections", t->connections);
    quotas = cJSON_AddObjectToObject(json, "quotas");
    if (t->quotas.rate > 0) cJSON_AddNumberToObject(quotas, "rate", t->quotas.rate);
    for (int i = 0; i < N_QUOTA; i++)
        if (quota(t, i))
            cJSON_AddNumberToObject(quotas, quota_words[i].word, (double)quota(t, i));
    return json;
}

static void print_token(const struct relight_token *t)
{
    char words[128] = "", expires[32];
    for (size_t i = 0, n = 0; i < t->n_scope && n < sizeof words; i++)
        n += (size_t)snprintf(words + n, sizeof words - n, "%s%s", i ? "," : "", t->scope[i]);
    print_day(expires, t->expires_s);
    bool over = t->expires_s && (time_t)t->expires_s <= time(NULL);
    printf("%-20s %-24s %-16s %4u  by %s", escape(t->name).text, escape(words).text,
           over ? "expired" : expires, t->connections, escape(t->by).text);
    if (t->quotas.rate > 0) printf("  rate=%g/s", t->quotas.rate);
    for (int i = 0; i < N_QUOTA; i++)
        if (quota(t, i))
            printf("  %s=%llu", quota_words[i].word, (unsigned long long)quota(t, i));
    printf("\n");
}

static int list(struct relight_client *client, const struct options *options)
{
    struct relight_error error;
    struct relight_tokens tokens;
    if (relight_token_list(client, &tokens, &error)) return report_error(options, &error);
    cJSON *json = options->json ? cJSON_CreateArray() : NULL;
    if (!json && tokens.n_token)
        printf("%-20s %-24s %-16s %4s\n", "NAME", "SCOPES", "EXPIRES", "OPEN");
    for (size_t i = 0; i < tokens.n_token; i++) {
        if (json) cJSON_AddItemToArray(json, token_json(&tokens.token[i]));
        else print_token(&tokens.token[i]);
    }
    if (json) print_json(json);
    relight_tokens_finish(&tokens);
    return EXIT_DONE;
}

static int revoke(struct relight_client *client, const struct options *options)
{
    struct relight_error error;
    uint32_t closed;
    const char *name = options->words[0] ? options->words[0] : options->token_order.name;
    if (!name) return report_usage(options, "revoke: NAME is missing");
    if (relight_token_revoke(client, name, &closed, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "connections", closed);
        print_json(json);
    } else {
        printf("%s is revoked, %u connections are closed\n", name, closed);
    }
    return EXIT_DONE;
}

int run_token(struct relight_client *client, struct options *options)
{
    if (!strcmp(options->target, "create")) return create(client, options);
    if (!strcmp(options->target, "list")) return list(client, options);
    if (!strcmp(options->target, "revoke")) return revoke(client, options);
    return report_usage(options, "%s: expected create, list or revoke", options->target);
}

int run_sign(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_link link;
    if (relight_sign(client, options->target, options->token_order.lifetime_s, &link, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "url", link.url);
        cJSON_AddNumberToObject(json, "expires_s", (double)link.expires_s);
        print_json(json);
    } else {
        puts(link.url);
    }
    relight_link_finish(&link);
    return EXIT_DONE;
}
