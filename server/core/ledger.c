// SPDX-License-Identifier: MIT
// The ledger: charging, giving back, and the text of a refusal.
#include "core/ledger.h"

#include "core/options.h"

#include <assert.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct ledger {
    const struct options *options;
    struct principal *principal;
    uint64_t total[LEDGER_N];
    ledger_quotas_fn quotas;
    uint64_t least[LEDGER_N]; // the least limit that a principal had of its own; 0: none had
    void *quotas_user;
};

struct row {
    const char *name, *words, *unit, *option_client, *option_all;
};

static const struct row table[LEDGER_N] = {
#define X(name, words, unit, by_client, in_all) \
    [LEDGER_##name] = {#name, words, unit, #by_client, #in_all},
    LEDGER_LIST(X)
#undef X
};

// The option's limit for every principal.
static uint64_t limit_of_option(const struct options *o, enum ledger_resource resource)
{
    switch (resource) {
#define X(name, words, unit, by_client, in_all) \
    case LEDGER_##name:                         \
        return o->by_client;
        LEDGER_LIST(X)
#undef X
    default:
        return 0;
    }
}

uint64_t ledger_limit_client(const struct principal *principal, enum ledger_resource resource)
{
    uint64_t own = principal->limit[resource];
    return own ? own : limit_of_option(principal->ledger->options, resource);
}

uint64_t ledger_limit_least(const struct ledger *ledger, enum ledger_resource resource)
{
    if (resource >= LEDGER_N) return 0;
    uint64_t every = limit_of_option(ledger->options, resource), own = ledger->least[resource];
    return own && (!every || own < every) ? own : every;
}

uint64_t ledger_limit_all(const struct ledger *ledger, enum ledger_resource resource)
{
    const struct options *o = ledger->options;
    switch (resource) {
#define X(name, words, unit, by_client, in_all) \
    case LEDGER_##name:                         \
        return o->in_all;
        LEDGER_LIST(X)
#undef X
    default:
        return 0;
    }
}

bool ledger_above_share(const struct ledger *ledger, enum ledger_resource resource,
                        const char *name, const char *asker, uint64_t more)
{
    uint64_t n = 0, own = 0, all = ledger_limit_all(ledger, resource);
    for (const struct principal *p = ledger->principal; p; p = p->next) {
        bool asks = asker && !strcmp(p->name, asker);
        uint64_t held = p->held[resource] + (asks ? more : 0);
        n += held > 0;
        if (!strcmp(p->name, name)) own = held;
    }
    return all && own > all / (n ? n : 1);
}

const char *ledger_name(enum ledger_resource resource)
{
    static char lower[LEDGER_N][24];
    for (size_t i = 0; table[resource].name[i]; i++)
        lower[resource][i] =
            (char)(table[resource].name[i] | (table[resource].name[i] == '_' ? 0 : 32));
    return lower[resource];
}

struct ledger *ledger_create(const struct options *options)
{
    struct ledger *ledger = calloc(1, sizeof *ledger);
    if (ledger) ledger->options = options;
    return ledger;
}

void ledger_destroy(struct ledger *ledger)
{
    if (!ledger) return;
    for (struct principal *p = ledger->principal, *next; p; p = next) {
        next = p->next;
        free(p);
    }
    free(ledger);
}

static void fill_limits(struct principal *p)
{
    struct ledger *ledger = p->ledger;
    if (!ledger->quotas) return;
    ledger->quotas(ledger->quotas_user, p->name, p->limit);
    for (int i = 0; i < LEDGER_N; i++)
        if (p->limit[i] && (!ledger->least[i] || p->limit[i] < ledger->least[i]))
            ledger->least[i] = p->limit[i];
}

void ledger_set_quotas(struct ledger *ledger, ledger_quotas_fn quotas, void *user)
{
    ledger->quotas = quotas;
    ledger->quotas_user = user;
    ledger_update_quotas(ledger);
}

void ledger_update_quotas(struct ledger *ledger)
{
    for (struct principal *p = ledger->principal; p; p = p->next) fill_limits(p);
}

struct principal *ledger_principal(struct ledger *ledger, const char *name)
{
    for (struct principal *p = ledger->principal; p; p = p->next)
        if (!strcmp(p->name, name)) {
            p->refs++;
            return p;
        }
    struct principal *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    p->next = ledger->principal;
    p->ledger = ledger;
    p->refs = 1;
    snprintf(p->name, sizeof p->name, "%s", name);
    fill_limits(p);
    ledger->principal = p;
    return p;
}

static void free_if_unused(struct principal *principal)
{
    if (principal->refs) return;
    for (int i = 0; i < LEDGER_N; i++)
        if (principal->held[i]) return;
    struct principal **at = &principal->ledger->principal;
    while (*at != principal) at = &(*at)->next;
    *at = principal->next;
    free(principal);
}

void principal_hold(struct principal *principal)
{
    principal->refs++;
}

void principal_release(struct principal *principal)
{
    if (!principal) return;
    assert(principal->refs);
    principal->refs--;
    free_if_unused(principal);
}

// An option's word from its field: client_views is --client-views.
static void option_word(const char *field, char word[64])
{
    snprintf(word, 64, "--%s", field);
    for (char *c = word; *c; c++)
        if (*c == '_') *c = '-';
}

enum ledger_refusal ledger_take(struct principal *principal, enum ledger_resource resource,
                                uint64_t amount, char error[256])
{
    struct ledger *ledger = principal->ledger;
    const struct row *row = &table[resource];
    uint64_t mine = principal->held[resource], all = ledger->total[resource];
    uint64_t most = ledger_limit_client(principal, resource);
    uint64_t most_all = ledger_limit_all(ledger, resource);
    char word[64];
    if (most && (amount > most || mine > most - amount)) {
        if (principal->limit[resource]) snprintf(word, sizeof word, "your token's quota");
        else option_word(row->option_client, word);
        snprintf(error, 256,
                 "%s: you hold %llu%s, %llu more would pass your limit of %llu (%s)",
                 row->words, (unsigned long long)mine, row->unit, (unsigned long long)amount,
                 (unsigned long long)most, word);
        return LEDGER_CLIENT_FULL;
    }
    if (most_all && (amount > most_all || all > most_all - amount)) {
        option_word(row->option_all, word);
        snprintf(error, 256, "%s: %llu more would pass the daemon's limit of %llu%s (%s)",
                 row->words, (unsigned long long)amount, (unsigned long long)most_all,
                 row->unit, word);
        return LEDGER_ALL_FULL;
    }
    principal->held[resource] += amount;
    ledger->total[resource] += amount;
    return LEDGER_GRANTED;
}

void ledger_force(struct principal *principal, enum ledger_resource resource, uint64_t amount)
{
    principal->held[resource] += amount;
    principal->ledger->total[resource] += amount;
}

void ledger_give(struct principal *principal, enum ledger_resource resource, uint64_t amount)
{
    assert(principal->held[resource] >= amount);
    assert(principal->ledger->total[resource] >= amount);
    principal->held[resource] -= amount;
    principal->ledger->total[resource] -= amount;
    free_if_unused(principal);
}

uint64_t ledger_total(const struct ledger *ledger, enum ledger_resource resource)
{
    return ledger->total[resource];
}

const struct principal *ledger_first(const struct ledger *ledger)
{
    return ledger->principal;
}
