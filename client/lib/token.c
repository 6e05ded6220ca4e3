// SPDX-License-Identifier: MIT
// Tokens of a daemon: create, list, revoke; links signed by one.
#include "internal.h"

#include <stdio.h>

static int no_memory(struct relight_error *error)
{
    return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
}

static void put_quotas(const struct relight_quotas *from, Relight__TokenQuotas *to)
{
    relight__token_quotas__init(to);
    to->rate = from->rate;
    to->connections = from->connections;
    to->requests = from->requests;
    to->views = from->views;
    to->memory = from->memory;
    to->output = from->output;
    to->bakes = from->bakes;
    to->uploads = from->uploads;
    to->models = from->models;
    to->disk = from->disk;
}

static void get_quotas(const Relight__TokenQuotas *from, struct relight_quotas *to)
{
    if (!from) return;
    *to = (struct relight_quotas){.rate = from->rate,
                                  .connections = from->connections,
                                  .requests = from->requests,
                                  .views = from->views,
                                  .memory = from->memory,
                                  .output = from->output,
                                  .bakes = from->bakes,
                                  .uploads = from->uploads,
                                  .models = from->models,
                                  .disk = from->disk};
}

int relight_token_create(struct relight_client *client, const struct relight_token_order *order,
                         char secret[RELIGHT_SECRET], struct relight_error *error)
{
    Relight__TokenCreateRequest m = RELIGHT__TOKEN_CREATE_REQUEST__INIT;
    Relight__TokenQuotas quotas;
    struct answer *answer;
    put_quotas(&order->quotas, &quotas);
    m.name = relight_text(order->name);
    m.scopes = (char **)(uintptr_t)order->scope;
    m.n_scopes = order->n_scope;
    m.lifetime_s = order->lifetime_s;
    m.quotas = &quotas;
    int status = relight_call(client, RELIGHT_TYPE_TOKEN_CREATE, &m.base, &answer, error);
    if (status) return status;
    const Relight__TokenCreateAnswer *a = (Relight__TokenCreateAnswer *)answer->message;
    size_t n = strlen(a->token);
    if (n && n < RELIGHT_SECRET) memcpy(secret, a->token, n + 1);
    else
        status = relight_fail(error, RELIGHT_E_PROTOCOL, "update the client",
                              "the daemon's token has %zu bytes", n);
    relight_answer_free(answer);
    return status;
}

int relight_token_list(struct relight_client *client, struct relight_tokens *out,
                       struct relight_error *error)
{
    Relight__TokenListRequest m = RELIGHT__TOKEN_LIST_REQUEST__INIT;
    struct answer *answer;
    int status = relight_call(client, RELIGHT_TYPE_TOKEN_LIST, &m.base, &answer, error);
    if (status) return status;
    const Relight__TokenListAnswer *a = (Relight__TokenListAnswer *)answer->message;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    struct relight_token *token = relight_owner_alloc(owner, a->n_tokens + 1, sizeof *token);
    if (!token) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    for (size_t i = 0; i < a->n_tokens; i++) {
        const Relight__TokenInfo *t = a->tokens[i];
        token[i] = (struct relight_token){.name = t->name,
                                          .by = t->by,
                                          .scope = (const char *const *)t->scopes,
                                          .n_scope = t->n_scopes,
                                          .created_s = t->created_s,
                                          .expires_s = t->expires_s,
                                          .connections = t->connections};
        get_quotas(t->quotas, &token[i].quotas);
    }
    *out = (struct relight_tokens){a->n_tokens, token, owner};
    return 0;
}

void relight_tokens_finish(struct relight_tokens *tokens)
{
    relight_owner_free(tokens->owner);
    *tokens = (struct relight_tokens){0};
}

int relight_token_revoke(struct relight_client *client, const char *name, uint32_t *connections,
                         struct relight_error *error)
{
    Relight__TokenRevokeRequest m = RELIGHT__TOKEN_REVOKE_REQUEST__INIT;
    struct answer *answer;
    m.name = relight_text(name);
    int status = relight_call(client, RELIGHT_TYPE_TOKEN_REVOKE, &m.base, &answer, error);
    if (status) return status;
    if (connections)
        *connections = ((Relight__TokenRevokeAnswer *)answer->message)->connections;
    relight_answer_free(answer);
    return 0;
}

int relight_sign(struct relight_client *client, const char *url, uint64_t lifetime_s,
                 struct relight_link *out, struct relight_error *error)
{
    Relight__SignRequest m = RELIGHT__SIGN_REQUEST__INIT;
    struct answer *answer;
    m.url = relight_text(url);
    m.lifetime_s = lifetime_s;
    int status = relight_call(client, RELIGHT_TYPE_SIGN, &m.base, &answer, error);
    if (status) return status;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    const Relight__SignAnswer *a = (Relight__SignAnswer *)answer->message;
    *out = (struct relight_link){.url = a->url, .expires_s = a->expires_s, .owner = owner};
    return 0;
}

void relight_link_finish(struct relight_link *link)
{
    relight_owner_free(link->owner);
    *link = (struct relight_link){0};
}
